"""Motions after which a part's surface is nearly where it was, such as a turn of a screw about its axis.

A camera may be unable to tell the two poses apart, and a gripper meets nearly the same surface in both. A slim rod that
is shifted along its axis by 0.15 d_max counts, too; one that is shifted by 0.2 d_max does not.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception.geometry import Floats, invert_transform
from perception.pose.model.surface_models import SurfaceModel

DISTANCE = 0.03  # largest distance of a moved sample from the surface, as a share of d_max
SHARE = 0.8  # least share of the samples that stay on the surface
_FACING = 0.7  # least cosine of the angle between the normals of a moved sample and of the surface there


class SameSurface:
    """Tells which poses of a part have nearly the same surface."""

    def __init__(self, surface: SurfaceModel) -> None:
        """Index the samples of a part's surface."""
        self._surface = surface
        self._tree = cKDTree(surface.points)

    def of(self, T_cam_part: Floats, others: Floats) -> NDArray[np.bool_]:
        """Return (K,) whether the part in each of (K, 4, 4) other poses covers nearly the same surface.

        Args:
            T_cam_part: (4, 4) pose of the part in the camera frame.
            others: (K, 4, 4) poses to compare with it.
        """
        motions = invert_transform(T_cam_part) @ others
        return np.array([self._share(motion) >= SHARE for motion in motions], np.bool_)

    def _share(self, motion: Floats) -> float:
        """Return the share of samples that a (4, 4) motion in the part frame leaves on the surface; 0 below `SHARE`."""
        surface = self._surface
        points, normals = surface.points @ motion[:3, :3].T + motion[:3, 3], surface.normals @ motion[:3, :3].T
        distance, found = self._tree.query(points, distance_upper_bound=2 * surface.spacing)
        near = np.isfinite(distance)
        if np.count_nonzero(near) < SHARE * len(points):
            return 0.0
        points, normals, nearest = points[near], normals[near], np.asarray(found)[near]
        gaps = np.abs(np.einsum("ni,ni->n", points - surface.points[nearest], surface.normals[nearest]))
        facing = np.einsum("ni,ni->n", normals, surface.normals[nearest])
        stays = (gaps <= DISTANCE * surface.d_max) & (facing > _FACING)
        return np.count_nonzero(stays) / len(surface.points)
