"""Agreement of fast and full simulation: the same attempts, with and without the physics of free motion."""

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from binpick_env.jobs.text_tables import columns
from policies.evaluation.statistics import Rate, rate
from policies.grasping.outcomes import GraspOutcome
from policies.picking.plan import Plan
from policies.selection.candidate_generator import CandidateGenerator
from policies.selection.env import GraspSelectionEnv

MAX_PILES = 1000  # limit on the piles that the attempts are collected from


@dataclass(frozen=True, kw_only=True)
class PairedAttempt:
    """One attempt from one state, in the full and in the fast simulation.

    Attributes:
        full: Outcome in the full simulation.
        fast: Outcome without the physics of free motion.
        seconds: Processor times of the full and the fast attempt, each with the next frame [s].
        shift: Largest distance between the two resting positions of a part that stayed in play in both [m].
    """

    full: GraspOutcome
    fast: GraspOutcome
    seconds: tuple[float, float]
    shift: float

    @property
    def agree(self) -> bool:
        """Whether both delivered or neither did, which is what rewards and episodes depend on."""
        return (self.full is GraspOutcome.DELIVERED) == (self.fast is GraspOutcome.DELIVERED)


def paired_attempts(full: GraspSelectionEnv, fast: GraspSelectionEnv, seed: int, count: int) -> Iterator[PairedAttempt]:
    """Attempt random grasp candidates, each in both simulations from the state of the full one.

    Args:
        full: Full simulation, which continues from attempt to attempt. A bin ends when it is empty, when it has no
            candidate, and after as many consecutive failures as the environment allows.
        fast: Fast simulation of the same part and cell, which takes over the full one's state before each attempt.
        seed: Seed of the first pile and of the choices; pile k has seed + k.
        count: Number of attempts.

    Raises:
        RuntimeError: The piles give fewer attempts.
    """
    rng = np.random.default_rng(seed)
    generator = CandidateGenerator(full.cell, full.picker, full.per_part)
    done = 0
    for pile in range(seed, seed + MAX_PILES):
        full.reset(seed=pile)
        fast.reset(seed=pile)
        failures = 0
        while full.cell.remaining > 0 and failures != full.max_failures and not full.cell.truncated:
            candidates = generator.generate()
            plan = full.picker.plan(candidates.grasps[rng.choice(candidates.valid)]) if candidates else None
            if not isinstance(plan, Plan):
                break
            pair = _attempt(full, fast, plan)
            failures = 0 if pair.full is GraspOutcome.DELIVERED else failures + 1
            yield pair
            done += 1
            if done == count:
                return
    raise RuntimeError(f"{MAX_PILES} piles did not give {count} attempts")


def agreement_table(pairs: Sequence[PairedAttempt]) -> str:
    """Return the shares of equal outcomes with 95 % intervals, the outcomes that differ, and the times, as text."""
    same_delivery = rate(sum(pair.agree for pair in pairs), len(pairs))
    same_outcome = rate(sum(pair.full is pair.fast for pair in pairs), len(pairs))
    delivered = [
        sum(outcome is GraspOutcome.DELIVERED for outcome in outcomes)
        for outcomes in ([pair.full for pair in pairs], [pair.fast for pair in pairs])
    ]
    full, fast = np.array([pair.seconds for pair in pairs]).T
    rows = [
        ("attempts", str(len(pairs))),
        ("equal in delivery", _share(same_delivery)),
        ("equal in outcome", _share(same_outcome)),
        ("delivered, full and fast", f"{delivered[0]} and {delivered[1]}"),
        ("median shift of the other parts", f"{1000 * float(np.median([pair.shift for pair in pairs])):.2f} mm"),
        ("processor time of an attempt and its frame, full", f"{full.mean():.3f} s"),
        ("likewise, fast", f"{fast.mean():.3f} s, {full.sum() / fast.sum():.2f} times as fast"),
    ]
    odd = Counter((str(pair.full), str(pair.fast)) for pair in pairs if pair.full is not pair.fast)
    rows += [(f"{one} in full, {other} fast", str(n)) for (one, other), n in odd.most_common()]
    return columns(rows)


def _share(same: Rate) -> str:
    return f"{same.successes} / {same.n}, 95 % {100 * same.low:.1f} to {100 * same.high:.1f} %"


def _attempt(full: GraspSelectionEnv, fast: GraspSelectionEnv, plan: Plan) -> PairedAttempt:
    fast.cell.restore(full.cell.snapshot())
    started = time.process_time()
    fast_result = fast.picker.execute(plan)
    between = time.process_time()
    full_result = full.picker.execute(plan)
    ended = time.process_time()
    assert full_result.outcome is not None
    assert fast_result.outcome is not None
    both = full.cell.simulation.in_play & fast.cell.simulation.in_play
    moved = full.cell.simulation.part_centres() - fast.cell.simulation.part_centres()
    shift = float(np.linalg.norm(moved[both], axis=1).max(initial=0.0))
    return PairedAttempt(
        full=full_result.outcome, fast=fast_result.outcome, seconds=(ended - between, between - started), shift=shift
    )
