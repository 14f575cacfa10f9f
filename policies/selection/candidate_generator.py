"""Grasp candidates: up to K grasps that are clear of the observed scene and within reach, with their features."""

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
ROWS = 32  # K, the number of rows of an observation
PER_PART = 3  # candidates per part: the 9 to 14 parts of a standard bin that have a grasp then all fit in


def _no_rows() -> NDArray[np.float32]:
    return np.zeros((ROWS, len(FEATURES)), dtype=np.float32)


def _no_mask() -> NDArray[np.bool_]:
    return np.zeros(ROWS, dtype=np.bool_)


@dataclass(frozen=True, eq=False, kw_only=True)
class GraspCandidates:
    """The grasp candidates in one frame.

    Attributes:
        grasps: At most K grasps in the order of the scripted picker, which would take the first.
        rows: (K, F) features of the grasps, zero in empty rows.
        mask: (K,) bool, whether the row holds a candidate that can be chosen.
        reason: Why no row does; None if one does.
    """

    grasps: tuple[GraspCandidate, ...] = ()
    rows: NDArray[np.float32] = field(default_factory=_no_rows)
    mask: NDArray[np.bool_] = field(default_factory=_no_mask)
    reason: Abstention | None = Abstention.NO_CANDIDATE

    def __bool__(self) -> bool:
        """Whether there is a candidate to choose."""
        return bool(self.mask.any())

    @property
    def valid(self) -> list[int]:
        """Rows that can be chosen."""
        return [int(row) for row in np.flatnonzero(self.mask)]

    def observation(self) -> Observation:
        """Return the observation of `BinPickSelect-v0`: `grasps` (K, F) float32 and `mask` (K,) int8."""
        return {"grasps": self.rows.copy(), "mask": self.mask.astype(np.int8)}

    def without(self, row: int) -> "GraspCandidates":
        """Return the candidates without the one in ``row``, whose path turned out to be blocked."""
        rows, mask = self.rows.copy(), self.mask.copy()
        rows[row], mask[row] = 0.0, False
        return replace(self, rows=rows, mask=mask, reason=None if mask.any() else Abstention.NO_CLEAR_APPROACH)


class CandidateGenerator:
    """Generates the grasp candidates in the cell's last frame."""

    def __init__(self, env: BinPickEnv, picker: ScriptedPicker, per_part: int = PER_PART) -> None:
        """Keep the cell and the picker.

        Args:
            env: Unwrapped cell.
            picker: Picker that ranks grasps and solves their inverse kinematics.
            per_part: Largest number of candidates on one part.
        """
        most = picker.settings.rank.per_candidate
        if not 1 <= per_part <= most:
            raise ValueError(f"per_part must be from 1 to {most}, the number that the ranking keeps, got {per_part}")
        self._env, self._picker, self._per_part = env, picker, per_part

    def generate(self) -> GraspCandidates:
        """Return the best ``per_part`` reachable grasps of each part, at most K in all.

        Like the scripted picker, the generator gives up after ``grasps_tried`` grasps that are out of reach.
        """
        env, picker = self._env, self._picker
        if not env.candidates:
            return GraspCandidates(reason=Abstention.NO_CANDIDATE)
        kept: list[GraspCandidate] = []
        dexterity: list[float] = []
        count: Counter[int] = Counter()
        rejected: Counter[Abstention] = Counter()
        for grasp in picker.grasps():
            if len(kept) == ROWS or rejected.total() == picker.settings.grasps_tried:
                break
            if count[grasp.candidate] == self._per_part:
                continue
            solution = picker.reach(grasp)
            if isinstance(solution, Abstention):
                rejected[solution] += 1
                continue
            kept.append(grasp)
            dexterity.append(solution.min_singular_value)
            count[grasp.candidate] += 1
        if not kept:
            no_posture = set(rejected) == {Abstention.IK_INFEASIBLE}
            return GraspCandidates(reason=Abstention.IK_INFEASIBLE if no_posture else Abstention.NO_CLEAR_APPROACH)
        return self._with_features(kept, np.array(dexterity))

    def _with_features(self, grasps: list[GraspCandidate], dexterity: NDArray[np.float64]) -> GraspCandidates:
        rows, mask = _no_rows(), _no_mask()
        rows[: len(grasps)] = feature_rows(self._scene(), grasps, dexterity)
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
