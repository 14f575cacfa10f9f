"""Failed attempts of the current bin, and their effect on the ranking of grasps."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from binpick_env.candidates import PoseCandidate
from perception.geometry import Floats
from policies.grasping.outcomes import GraspCandidate


@dataclass(frozen=True, eq=False, kw_only=True)
class _Failure:
    """One failed attempt."""

    centre_world: Floats  # (3,) centre of the part [m]
    T_world_grasp: Floats  # (4, 4) grasp frame
    radius: float  # distance within which a part's centre is that of this part [m]


@dataclass(eq=False, kw_only=True)
class FailedGrasps:
    """Failed attempts of one bin. Parts are not tracked from frame to frame; their centres identify them.

    Attributes:
        radius: Distance between two centres under which they belong to the same part [m].
    """

    radius: float
    _failures: list[_Failure] = field(default_factory=list)

    def add(self, centre_world: Floats, T_world_grasp: Floats, radius: float | None = None) -> None:
        """Remember a (4, 4) grasp that failed on the part with a (3,) centre.

        Args:
            centre_world: Centre of the part [m].
            T_world_grasp: The grasp.
            radius: Distance within which parts are suspect afterwards [m]; ``self.radius`` if None.
        """
        within = self.radius if radius is None else radius
        self._failures.append(_Failure(centre_world=centre_world, T_world_grasp=T_world_grasp, radius=within))

    def suspect(self, centre_world: Floats) -> bool:
        """Return whether an attempt failed on the part with a (3,) centre."""
        return any(bool(np.linalg.norm(centre_world - f.centre_world) < f.radius) for f in self._failures)

    def without_failed(
        self, ranked: Sequence[GraspCandidate], candidates: Sequence[PoseCandidate]
    ) -> list[GraspCandidate]:
        """Leave out grasps that failed before, and move other grasps on the same parts to the end.

        Args:
            ranked: Grasps, best first.
            candidates: Parts that the grasps are on.

        Returns:
            The remaining grasps in their new order.
        """
        suspect = [self.suspect(candidates[grasp.candidate].centre_world) for grasp in ranked]
        order = np.argsort(suspect, kind="stable")
        again = [any(_same_grasp(grasp.T_world_grasp, f.T_world_grasp) for f in self._failures) for grasp in ranked]
        return [ranked[k] for k in order if not again[k]]


def _same_grasp(T_a: Floats, T_b: Floats) -> bool:
    """Return whether fingertips are within 8 mm and approach and closing axis, without its sign, within 15 degrees."""
    near = float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])) < 0.008
    cosine = np.cos(np.radians(15))
    return near and T_a[:3, 2] @ T_b[:3, 2] > cosine and abs(T_a[:3, 1] @ T_b[:3, 1]) > cosine
