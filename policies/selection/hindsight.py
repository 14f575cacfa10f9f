"""The picker that knows how an attempt ends: a bound for those who have to choose before."""

import time
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import islice

from binpick_env.env import BinPickEnv
from binpick_env.episode import Snapshot
from policies.evaluation.records import BinRecord
from policies.grasping.failed_grasps import FailedGrasps
from policies.grasping.outcomes import Abstention, GraspOutcome, PickResult
from policies.picking.scripted import T_SENSE, ScriptedPicker
from policies.selection.candidate_generator import PER_PART, ROWS, GraspCandidates
from policies.selection.candidate_picker import CandidatePicker

HINDSIGHT = "hindsight"  # its name among selectors
TRIED = "tried"  # among a grasp's features: how many attempts were made from one state, for one to be kept
_State = tuple[Snapshot, FailedGrasps]  # of the cell, and what the picker has learned in it


class HindsightPicker(CandidatePicker):
    """A `policies.picking.episode.Picker` that tries the rows on offer, each from the same state, until one delivers.

    The rows come in their own order, the scripted picker's. The first attempt that delivers is kept; if none does, the
    first of all, the failure that would have been. Every other one is undone, to the bit, with what the picker had
    learned from it. A row whose path turns out to be blocked is no attempt.

    Unless ``most`` cuts it short, no selector of these rows wins a decision that this picker loses. It looks one
    attempt ahead and no further: a delivery that buries another part it takes as gladly as one that does not, so that a
    selector may, in principle, still do better over a whole bin.

    The result's grasp says under `TRIED` among its features how many attempts were made. Its ``t_compute`` is that of
    the attempt that was kept. Who films or records the cell sees the attempts that are undone, too.
    """

    def __init__(
        self,
        env: BinPickEnv,
        picker: ScriptedPicker | None = None,
        *,
        per_part: int = PER_PART,
        most: int = ROWS,
    ) -> None:
        """Keep the cell.

        Args:
            env: The unwrapped cell.
            picker: Ranks, plans and executes; a new one if None.
            per_part: At most so many grasps of each part.
            most: Attempts from one state, at most.
        """
        if most < 1:
            raise ValueError(f"most must be at least 1, got {most}")
        super().__init__(env, picker, per_part)
        self._most = most
        self.reset()

    def pick(self) -> PickResult:
        """Make one decision on the last frame: the attempt that is kept, or an abstention."""
        frame_id = self._env.frame_id
        offer, offered = self._offer()
        started = time.perf_counter()
        first: tuple[PickResult, _State] | None = None
        tried = 0
        for result in islice(self._attempts(offer), self._most):
            tried += 1
            if result.success:
                return _kept(result, tried, offered)
            first = first or (result, self._state())
        if first is None:
            reason = offer.reason or Abstention.NO_CLEAR_APPROACH
            compute = offered + time.perf_counter() - started
            return PickResult(abstention=reason, t_sense=T_SENSE, t_compute=compute, frame_id=frame_id)
        result, after = first
        self._go_back(after)
        return _kept(result, tried, offered)

    def _attempts(self, offer: GraspCandidates) -> Iterator[PickResult]:
        """Make the attempts on offer, each from the state that the cell is in now."""
        before = self._state()
        for row in offer.valid:
            started = time.perf_counter()
            plan = self._picker.plan(offer.grasps[row])
            if isinstance(plan, Abstention):
                continue
            planning = time.perf_counter() - started
            result = self._picker.execute(plan)
            yield replace(result, t_compute=planning + result.t_compute)
            self._go_back(before)

    def _state(self) -> _State:
        return self._env.snapshot(), deepcopy(self._picker.failed)

    def _go_back(self, state: _State) -> None:
        snapshot, failed = state
        self._env.restore(snapshot)
        self._picker.failed = deepcopy(failed)


@dataclass(frozen=True, kw_only=True)
class HindsightTally:
    """What came of decisions that were made with hindsight, abstentions left out.

    Attributes:
        first: In how many the first attempt delivered.
        another: In how many the first attempt failed and another one delivered.
        none: In how many none delivered.
        tries: Attempts made in all of them, those that were undone included.
    """

    first: int
    another: int
    none: int
    tries: int

    @property
    def decisions(self) -> int:
        """How many there were."""
        return self.first + self.another + self.none

    def __str__(self) -> str:
        """Say it in a sentence."""
        return (
            f"of {self.decisions} decisions with hindsight, the first attempt delivered in {self.first}, only another "
            f"in {self.another}, none in {self.none}; {self.tries} attempts were tried"
        )


def hindsight_tally(records: Sequence[BinRecord]) -> HindsightTally:
    """Count the decisions of a `HindsightPicker`, from the records of its bins."""
    attempts = [pick for record in records for pick in record.attempts]
    tries = [round(pick.features[TRIED]) for pick in attempts]
    delivered = [n for n, pick in zip(tries, attempts, strict=True) if pick.outcome is GraspOutcome.DELIVERED]
    first = delivered.count(1)
    return HindsightTally(
        first=first, another=len(delivered) - first, none=len(attempts) - len(delivered), tries=sum(tries)
    )


def _kept(result: PickResult, tried: int, compute: float) -> PickResult:
    """Return an attempt with the number of those that were made for it, and ``compute`` [s] more."""
    assert result.grasp is not None
    grasp = replace(result.grasp, features={**result.grasp.features, TRIED: float(tried)})
    return replace(result, grasp=grasp, t_compute=compute + result.t_compute)
