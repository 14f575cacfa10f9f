"""What can be picked now: up to K grasps that are clear of the scene and within reach, with their features."""

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from binpick_env.env import BinPickEnv
from policies.grasping.outcomes import Abstention, GraspCandidate
from policies.picking.scripted import ScriptedPicker
from policies.selection.features import FEATURES, GraspScene, feature_rows

Observation = dict[str, NDArray[Any]]
ROWS = 32  # K
PER_PART = 3  # grasps of each part: those parts of a standard bin that have any, 9 to 14, then all fit in


def _no_rows() -> NDArray[np.float32]:
    return np.zeros((ROWS, len(FEATURES)), dtype=np.float32)


def _no_mask() -> NDArray[np.bool_]:
    return np.zeros(ROWS, dtype=np.bool_)


@dataclass(frozen=True, eq=False, kw_only=True)
class GraspCandidates:
    """The grasps of one frame.

    Attributes:
        grasps: At most K, in the scripted picker's order: it would take the first.
        rows: (K, F) their features, zero beyond them.
        mask: (K,) whether the row holds a grasp that can be chosen.
        reason: Why there is none, if there is none.
    """

    grasps: tuple[GraspCandidate, ...] = ()
    rows: NDArray[np.float32] = field(default_factory=_no_rows)
    mask: NDArray[np.bool_] = field(default_factory=_no_mask)
    reason: Abstention | None = Abstention.NO_CANDIDATE

    def __bool__(self) -> bool:
        """Whether there is anything to choose."""
        return bool(self.mask.any())

    @property
    def valid(self) -> list[int]:
        """The rows that can be chosen."""
        return [int(row) for row in np.flatnonzero(self.mask)]

    def observation(self) -> Observation:
        """Return `grasps` (K, F) float32 and `mask` (K,) int8."""
        return {"grasps": self.rows.copy(), "mask": self.mask.astype(np.int8)}

    def without(self, row: int) -> "GraspCandidates":
        """Close one row: its path turned out to be blocked."""
        rows, mask = self.rows.copy(), self.mask.copy()
        rows[row], mask[row] = 0.0, False
        return replace(self, rows=rows, mask=mask, reason=None if mask.any() else Abstention.NO_CLEAR_APPROACH)


class CandidateGenerator:
    """Writes the offer for the environment's last frame."""

    def __init__(self, env: BinPickEnv, picker: ScriptedPicker, per_part: int = PER_PART) -> None:
        """Keep what it asks.

        Args:
            env: The cell.
            picker: Ranks the grasps and knows what the arm reaches.
            per_part: At most so many grasps of each part.
        """
        most = picker.settings.rank.per_candidate
        if not 1 <= per_part <= most:
            raise ValueError(f"per_part must be from 1 to {most}, the number that the ranking keeps, got {per_part}")
        self._env, self._picker, self._per_part = env, picker, per_part

    def offer(self) -> GraspCandidates:
        """Return the best ``per_part`` grasps of each part that the arm reaches, K of all at most.

        Like the scripted picker, it gives up after ``grasps_tried`` that are out of reach.
        """
        env, picker = self._env, self._picker
        if not env.candidates:
            return GraspCandidates(reason=Abstention.NO_CANDIDATE)
        kept: list[GraspCandidate] = []
        margins: list[float] = []
        taken: Counter[int] = Counter()
        refused: Counter[Abstention] = Counter()
        for grasp in picker.grasps():
            if len(kept) == ROWS or refused.total() == picker.settings.grasps_tried:
                break
            if taken[grasp.candidate] == self._per_part:
                continue
            reached = picker.reach(grasp)
            if isinstance(reached, Abstention):
                refused[reached] += 1
                continue
            kept.append(grasp)
            margins.append(reached.min_singular_value)
            taken[grasp.candidate] += 1
        if not kept:
            unreached = set(refused) == {Abstention.IK_INFEASIBLE}
            return GraspCandidates(reason=Abstention.IK_INFEASIBLE if unreached else Abstention.NO_CLEAR_APPROACH)
        return self._written(kept, np.array(margins))

    def _written(self, grasps: list[GraspCandidate], margins: NDArray[np.float64]) -> GraspCandidates:
        rows, mask = _no_rows(), _no_mask()
        rows[: len(grasps)] = feature_rows(self._scene(), grasps, margins)
        mask[: len(grasps)] = True
        return GraspCandidates(grasps=tuple(grasps), rows=rows, mask=mask, reason=None)

    def _scene(self) -> GraspScene:
        env, picker = self._env, self._picker
        return GraspScene(
            seen=picker.observed_scene(),
            d_max=env.part.model.d_max,
            gripper=picker.gripper,
            rank=picker.settings.rank,
            failed=picker.failed,
        )
