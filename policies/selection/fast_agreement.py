"""Does an attempt come out the same without the physics of free motion? The same attempts, made both ways."""

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from binpick_env.jobs.text_tables import columns
from policies.evaluation.statistics import rate
from policies.grasping.outcomes import GraspOutcome
from policies.picking.scripted import Plan
from policies.selection.candidate_generator import CandidateGenerator
from policies.selection.env import GraspSelectionEnv

MAX_PILES = 1000  # until the attempts must have come together


@dataclass(frozen=True, kw_only=True)
class Pair:
    """One attempt from one state, made in full and fast.

    Attributes:
        full: Outcome of the full simulation.
        fast: Outcome without the physics of free motion.
        seconds: Processor time of both, in this order, with the next frame.
        shift: Largest distance between the places at which a part that both left in play came to rest [m].
    """

    full: GraspOutcome
    fast: GraspOutcome
    seconds: tuple[float, float]
    shift: float

    @property
    def agree(self) -> bool:
        """Whether both delivered, or both did not: what reward and episode depend on."""
        return (self.full is GraspOutcome.DELIVERED) == (self.fast is GraspOutcome.DELIVERED)


def paired_attempts(full: GraspSelectionEnv, fast: GraspSelectionEnv, seed: int, count: int) -> Iterator[Pair]:
    """Attempt random grasps of those on offer, each twice from the state that the full simulation is in.

    Args:
        full: Goes on from attempt to attempt; a bin is over when it is empty, offers nothing, or after the failures in
            a row that the environment allows.
        fast: Of the same part and cell; put into the other's state before each attempt.
        seed: Of the first pile; the next have those that follow. Grasps are drawn with it too.
        count: How many attempts.

    Raises:
        RuntimeError: The piles do not give so many.
    """
    rng = np.random.default_rng(seed)
    menu = CandidateGenerator(full.cell, full.picker, full.per_part)
    done = 0
    for pile in range(seed, seed + MAX_PILES):
        full.reset(seed=pile)
        fast.reset(seed=pile)
        failures = 0
        while full.cell.remaining > 0 and failures != full.max_failures and not full.cell.truncated:
            offer = menu.offer()
            plan = full.picker.plan(offer.grasps[rng.choice(offer.valid)]) if offer else None
            if not isinstance(plan, Plan):
                break
            pair = _attempt(full, fast, plan)
            failures = 0 if pair.full is GraspOutcome.DELIVERED else failures + 1
            yield pair
            done += 1
            if done == count:
                return
    raise RuntimeError(f"{MAX_PILES} piles did not give {count} attempts")


def agreement_table(pairs: Sequence[Pair]) -> str:
    """Return the share of equal outcomes with its interval, the outcomes that differ, and the times, as text."""
    same = rate(sum(pair.agree for pair in pairs), len(pairs))
    named = rate(sum(pair.full is pair.fast for pair in pairs), len(pairs))
    won = [sum(outcome is GraspOutcome.DELIVERED for outcome in each) for each in zip(*_outcomes(pairs), strict=True)]
    full, fast = np.array([pair.seconds for pair in pairs]).T
    rows = [
        ("attempts", str(len(pairs))),
        ("equal in delivery", f"{same.successes} / {same.n}, 95 % {100 * same.low:.1f} to {100 * same.high:.1f} %"),
        ("equal in outcome", f"{named.successes} / {named.n}, 95 % {100 * named.low:.1f} to {100 * named.high:.1f} %"),
        ("delivered, full and fast", f"{won[0]} and {won[1]}"),
        ("median shift of the rest", f"{1000 * float(np.median([pair.shift for pair in pairs])):.2f} mm"),
        ("processor time of an attempt and its frame, full", f"{full.mean():.3f} s"),
        ("likewise, fast", f"{fast.mean():.3f} s, {full.sum() / fast.sum():.2f} times as fast"),
    ]
    odd = Counter((str(pair.full), str(pair.fast)) for pair in pairs if pair.full is not pair.fast)
    rows += [(f"{one} in full, {other} fast", str(n)) for (one, other), n in odd.most_common()]
    return columns(rows)


def _outcomes(pairs: Sequence[Pair]) -> list[tuple[GraspOutcome, GraspOutcome]]:
    return [(pair.full, pair.fast) for pair in pairs]


def _attempt(full: GraspSelectionEnv, fast: GraspSelectionEnv, plan: Plan) -> Pair:
    fast.cell.restore(full.cell.snapshot())
    started = time.process_time()
    twin = fast.picker.execute(plan)
    between = time.process_time()
    result = full.picker.execute(plan)
    ended = time.process_time()
    assert result.outcome is not None
    assert twin.outcome is not None
    both = full.cell.simulation.in_play & fast.cell.simulation.in_play
    moved = full.cell.simulation.part_centres() - fast.cell.simulation.part_centres()
    shift = float(np.linalg.norm(moved[both], axis=1).max(initial=0.0))
    return Pair(full=result.outcome, fast=twin.outcome, seconds=(ended - between, between - started), shift=shift)
