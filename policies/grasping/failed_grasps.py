"""What was tried in vain in this bin, and what that says about the grasps that are left."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from binpick_env.candidates import PoseCandidate
from perception.geometry import Floats
from policies.grasping.outcomes import GraspCandidate


@dataclass(frozen=True, eq=False, kw_only=True)
class _Failure:
    """The part's centre (3,) [m] and the grasp (4, 4), world frame."""

    centre_world: Floats
    T_world_grasp: Floats


@dataclass(eq=False, kw_only=True)
class FailedGrasps:
    """Failed attempts of one bin. Parts have no names from frame to frame: they are known by where their centres are.

    Attributes:
        reach: Candidates whose centres are nearer to each other than this are one part [m].
    """

    reach: float
    _failures: list[_Failure] = field(default_factory=list)

    def add(self, centre_world: Floats, T_world_grasp: Floats) -> None:
        """Remember a (4, 4) grasp that failed on the part with a (3,) centre."""
        self._failures.append(_Failure(centre_world=centre_world, T_world_grasp=T_world_grasp))

    def suspect(self, centre_world: Floats) -> bool:
        """Whether an attempt failed on the part with a (3,) centre."""
        return any(bool(np.linalg.norm(centre_world - f.centre_world) < self.reach) for f in self._failures)

    def fresh_first(
        self, ranked: Sequence[GraspCandidate], candidates: Sequence[PoseCandidate]
    ) -> list[GraspCandidate]:
        """Leave out grasps that failed before, and put others on the parts that they failed on behind all else.

        Args:
            ranked: Grasps, best first.
            candidates: The parts that they are on.
        """
        suspect = [self.suspect(candidates[grasp.candidate].centre_world) for grasp in ranked]
        order = np.argsort(suspect, kind="stable")
        again = [any(_alike(grasp.T_world_grasp, f.T_world_grasp) for f in self._failures) for grasp in ranked]
        return [ranked[k] for k in order if not again[k]]


def _alike(T_a: Floats, T_b: Floats) -> bool:
    """Whether two grasps are one: tips within 8 mm, approach and jaw within 15 degrees, the jaw without a sign."""
    near = float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])) < 0.008
    cosine = np.cos(np.radians(15))
    return near and T_a[:3, 2] @ T_b[:3, 2] > cosine and abs(T_a[:3, 1] @ T_b[:3, 1]) > cosine
