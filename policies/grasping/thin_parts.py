"""Grasps of a thin part that lies flat on the floor: the fingertips hold its rim and keep off the floor."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from perception.geometry import Floats
from policies.grasping.gripper import PAD_SIZE

_FLOOR_NOISE = 0.0015  # height by which a measured floor seems higher than it is [m]
_RESERVE = 0.0003  # height of sampled fingertips above the least ones [m]
_LEVEL = 0.17  # sine of the largest angle between a line through the part and its broad sides
_UPRIGHT = 0.7  # cosine of the largest angle between the approach and the thickness


@dataclass(frozen=True, eq=False, kw_only=True)
class BroadSides:
    """The two broadest sides of a part's least bounding box, on which it may lie; of a thin rod these are two of four.

    Attributes:
        centre: (3,) centre of the box, part frame [m].
        axis: (3,) unit direction of the thickness, part frame.
        thickness: Distance between the two sides [m].
        thin: Whether the part is thin; there are no such grasps on a part that is not.
    """

    centre: Floats
    axis: Floats
    thickness: float
    thin: bool

    @classmethod
    def of_thin_part(cls, mesh: trimesh.Trimesh, thin: float) -> "BroadSides":
        """Measure a mesh [m], which is thin if its box is thinner than ``thin`` [m]."""
        box = mesh.bounding_box_oriented.primitive
        k = int(np.argmin(box.extents))
        thickness = float(box.extents[k])
        return cls(centre=box.transform[:3, 3], axis=box.transform[:3, k], thickness=thickness, thin=thickness < thin)

    def grasps_off_the_floor(self, first: Floats, second: Floats, margin: float) -> tuple[Floats, Floats]:
        """Return upright grasps across the part, whose fingertips end a little above the side that it lies on.

        Args:
            first: (M, 3) points on faces of the part [m].
            second: (M, 3) points on the opposite faces [m].
            margin: Least height of the fingertips' ends above the floor [m].

        Returns:
            (N, 4, 4) grasps in the part frame, and their (N,) widths [m]: for each line along the broad sides, on both
            sides, one grasp as deep as the margin allows and one that noise of a measured floor does not reach, too.
        """
        line = second - first
        width = np.linalg.norm(line, axis=1)
        level = np.flatnonzero(np.abs(line @ self.axis) < _LEVEL * width) if self.thin else np.zeros(0, np.int64)
        y = line[level] - (line[level] @ self.axis)[:, None] * self.axis
        y /= np.linalg.norm(y, axis=1, keepdims=True)
        middle = (first[level] + second[level]) / 2
        middle -= ((middle - self.centre) @ self.axis)[:, None] * self.axis  # halfway between the broad sides
        frames = []
        for up in (self.axis, -self.axis):
            for height in (margin, margin + _FLOOR_NOISE):
                T = np.tile(np.eye(4), (len(level), 1, 1))
                T[:, :3, 0], T[:, :3, 1], T[:, :3, 2] = np.cross(y, -up), y, -up
                T[:, :3, 3] = middle + (height + _RESERVE - self.thickness / 2) * up
                frames.append(T)
        return np.concatenate(frames), np.tile(width[level], len(frames))

    def shallow(self, T_part_grasp: Floats, width: Floats, margin: float) -> NDArray[np.int64]:
        """Tell which of (N, 4, 4) grasps pick the part off the floor on which it lies flat.

        They have less contact than deeper ones, and would otherwise be thinned out in their favour.

        Returns:
            (N,) 0 for those that do not, and for all if the part is not thin; 1 for those that keep ``margin`` from
            the floor itself; 2 for those that also keep it from a measured floor, which noise makes higher.
        """
        if not self.thin:
            return np.zeros(len(width), dtype=np.int64)
        x, y, z = (T_part_grasp[:, :3, k] @ self.axis for k in range(3))
        over_centre = (T_part_grasp[:, :3, 3] - self.centre) @ self.axis * -np.sign(z)  # the approach is downwards
        spread = np.abs(x) * PAD_SIZE[0] / 2 + np.abs(y) * (width / 2 + PAD_SIZE[1])
        lowest = over_centre + self.thickness / 2 - spread  # of the fingertips' ends, above the floor
        upright = np.abs(z) > _UPRIGHT
        clear = upright & (lowest > margin)
        return clear.astype(np.int64) + (upright & (lowest > margin + _FLOOR_NOISE))
