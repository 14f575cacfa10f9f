"""Clustering of poses modulo the part's symmetry."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, require_shape, transform_point_each
from perception.part import PartModel, Symmetry


@dataclass(frozen=True, kw_only=True)
class ClusterConfig:
    """Largest difference between a pose and the representative of its cluster.

    Attributes:
        translation: Largest distance between the part's centres, as a share of d_max.
        rotation: Largest angle between the rotations modulo symmetry [rad].
    """

    translation: float = 0.10
    rotation: float = float(np.deg2rad(15.0))

    def __post_init__(self) -> None:
        if not 0 < self.translation < np.inf:
            raise ValueError(f"translation must be positive, got {self.translation}")
        if not 0 < self.rotation <= np.pi:
            raise ValueError(f"rotation must be in (0, pi] rad, got {self.rotation}")


def cluster_poses(
    T_cam_part: Floats, scores: Floats, part: PartModel, config: ClusterConfig | None = None
) -> tuple[NDArray[np.int64], Floats]:
    """Cluster poses; each cluster is represented by its best member, and nothing is averaged.

    The best remaining pose represents the next cluster, which takes every remaining pose that is near it. So no pose
    has a higher score than its representative, and no two representatives are near each other.

    Args:
        T_cam_part: (K, 4, 4) poses of the part in the camera frame.
        scores: (K,) scores of at least 0, such as votes; larger is better.
        part: Part that the poses are of.
        config: Size of a cluster; the defaults of :class:`ClusterConfig` if None.

    Returns:
        The (C,) indices of the representatives, and the (C,) sums of their clusters' scores, by which both are sorted,
        largest first. Of equal sums the lower index comes first.

    Raises:
        ValueError: Shapes differ, a pose is not finite, or a score is negative or not finite.
    """
    config = config or ClusterConfig()
    require_shape("T_cam_part", T_cam_part, (None, 4, 4))
    require_shape("scores", scores, (len(T_cam_part),))
    if not np.isfinite(T_cam_part).all():
        raise ValueError("T_cam_part must be finite")
    if not (np.isfinite(scores).all() and np.all(scores >= 0)):
        raise ValueError("scores must be finite and 0 or more")
    centres = transform_point_each(T_cam_part, part.centre)
    remaining = np.argsort(-scores, kind="stable")
    representatives, sums = [], []
    while len(remaining):
        best = remaining[0]
        near = _near(best, remaining, centres, T_cam_part, part, config)
        near[0] = True
        representatives.append(best)
        sums.append(float(scores[remaining[near]].sum()))
        remaining = remaining[~near]
    order = np.lexsort((representatives, -np.array(sums)))
    return np.array(representatives, np.int64)[order], np.array(sums, np.float64)[order]


def are_alike(
    T_cam_part: Floats, others: Floats, part: PartModel, config: ClusterConfig | None = None
) -> NDArray[np.bool_]:
    """Return (K,) whether each pose would be in the cluster that another pose represents.

    Args:
        T_cam_part: (4, 4) pose of the part in the camera frame.
        others: (K, 4, 4) poses to compare with it.
        part: Part that the poses are of.
        config: Size of a cluster; the defaults of :class:`ClusterConfig` if None.

    Raises:
        ValueError: A shape is wrong.
    """
    require_shape("T_cam_part", T_cam_part, (4, 4))
    require_shape("others", others, (None, 4, 4))
    poses = np.concatenate([T_cam_part[None], others])
    indices = np.arange(1, len(poses))
    return _near(0, indices, transform_point_each(poses, part.centre), poses, part, config or ClusterConfig())


def _near(
    one: int, others: NDArray[np.int64], centres: Floats, poses: Floats, part: PartModel, config: ClusterConfig
) -> NDArray[np.bool_]:
    """Return (O,) whether ``others`` are within the limits of ``one``; both are indices into ``poses``."""
    near: NDArray[np.bool_] = np.linalg.norm(centres[others] - centres[one], axis=1) <= config.translation * part.d_max
    rotations = poses[others[near], :3, :3]
    near[near] = rotations_within(poses[one, :3, :3], rotations, part.symmetry, config.rotation)
    return near


def rotations_within(rotation: Floats, others: Floats, symmetry: Symmetry, limit: float) -> NDArray[np.bool_]:
    """Return (K,) whether each of (K, 3, 3) is within ``limit`` [rad] of a (3, 3) rotation modulo the symmetry.

    Equals a comparison of :meth:`perception.part.Symmetry.distance` with the limit, for many rotations at once. It
    compares cosines, which are not precise enough for limits near 0.
    """
    if symmetry.sphere:
        return np.ones(len(others), np.bool_)
    images = rotation @ symmetry.rotations
    if symmetry.axis is None:
        cosines = (images.reshape(-1, 9) @ others.reshape(-1, 9).T - 1) / 2
    else:
        cosines = (images @ symmetry.axis) @ (others @ symmetry.axis).T
    within: NDArray[np.bool_] = cosines.max(axis=0) >= np.cos(limit)
    return within
