"""Hindsight: a picker that knows how an attempt ends, as an upper bound for selectors that have to choose before."""

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

HINDSIGHT = "hindsight"  # name of this picker beside those of selectors
TRIED = "tried"  # entry in a grasp's features: number of attempts from one state, of which one is kept
_State = tuple[Snapshot, FailedGrasps]  # state of the cell, and the failed grasps that the picker remembers


class HindsightPicker(CandidatePicker):
    """A `policies.picking.episode.Picker` that attempts the candidates from the same state until one delivers.

    Candidates are attempted in the scripted picker's order. The first attempt that delivers is kept. If none delivers,
    the first attempt of all is kept, which is the failure that the scripted picker would have had. Every other attempt
    is undone bit for bit, with what the picker remembers of it. A candidate whose path is blocked is not attempted.

    Unless ``most`` ends the search, no selector delivers in a decision in which this picker fails. The search covers
    one attempt: a delivery that buries another part counts as much as one that does not, so that a selector may in
    principle still do better over a whole bin.

    The number of attempts is stored as `TRIED` in the features of the result's grasp. The result's ``t_compute`` is
    that of the attempt that is kept. Films and recordings of the cell contain the undone attempts as well.
    """

    def __init__(
        self,
        env: BinPickEnv,
        picker: ScriptedPicker | None = None,
        *,
        per_part: int = PER_PART,
        most: int = ROWS,
    ) -> None:
        """Build the picker.

        Args:
            env: Unwrapped cell.
            picker: Picker that ranks, plans and executes; a new one if None.
            per_part: Largest number of candidates on one part.
            most: Largest number of attempts from one state.
        """
        if most < 1:
            raise ValueError(f"most must be at least 1, got {most}")
        super().__init__(env, picker, per_part)
        self._most = most
        self.reset()

    def pick(self) -> PickResult:
        """Make one decision on the last frame: the attempt that is kept, or an abstention."""
        frame_id = self._env.frame_id
        candidates, generation_time = self._timed_candidates()
        started = time.perf_counter()
        first: tuple[PickResult, _State] | None = None
        tried = 0
        for result in islice(self._attempts(candidates), self._most):
            tried += 1
            if result.success:
                return _kept(result, tried, generation_time)
            first = first or (result, self._state())
        if first is None:
            reason = candidates.reason or Abstention.NO_CLEAR_APPROACH
            compute = generation_time + time.perf_counter() - started
            return PickResult(abstention=reason, t_sense=T_SENSE, t_compute=compute, frame_id=frame_id)
        result, after = first
        self._restore(after)
        return _kept(result, tried, generation_time)

    def _attempts(self, candidates: GraspCandidates) -> Iterator[PickResult]:
        """Attempt the candidates, each from the state that the cell is in now."""
        before = self._state()
        for row in candidates.valid:
            started = time.perf_counter()
            plan = self._picker.plan(candidates.grasps[row])
            if isinstance(plan, Abstention):
                continue
            planning = time.perf_counter() - started
            result = self._picker.execute(plan)
            yield replace(result, t_compute=planning + result.t_compute)
            self._restore(before)

    def _state(self) -> _State:
        return self._env.snapshot(), deepcopy(self._picker.failed)

    def _restore(self, state: _State) -> None:
        snapshot, failed = state
        self._env.restore(snapshot)
        self._picker.failed = deepcopy(failed)


@dataclass(frozen=True, kw_only=True)
class HindsightTally:
    """Decisions with hindsight, counted by their outcome; abstentions are left out.

    Attributes:
        first: Number of decisions in which the first attempt delivered.
        another: Number of decisions in which the first attempt failed and another one delivered.
        none: Number of decisions in which no attempt delivered.
        tries: Number of attempts in all decisions, including those that were undone.
    """

    first: int
    another: int
    none: int
    tries: int

    @property
    def decisions(self) -> int:
        """Number of decisions."""
        return self.first + self.another + self.none

    def __str__(self) -> str:
        """Describe the counts in a sentence."""
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
    """Return ``result`` with the number of attempts in its grasp, and ``compute`` [s] added to its ``t_compute``."""
    assert result.grasp is not None
    grasp = replace(result.grasp, features={**result.grasp.features, TRIED: float(tried)})
    return replace(result, grasp=grasp, t_compute=compute + result.t_compute)
