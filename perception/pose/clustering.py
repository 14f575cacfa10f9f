"""Poses that say the same, modulo the part's symmetry, become one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, require_shape, transform_point_each
from perception.part import PartModel, Symmetry


@dataclass(frozen=True, kw_only=True)
class ClusterConfig:
    """How near poses of one cluster lie to its head."""

    translation: float = 0.10  # of the part's centre, as a share of d_max
    rotation: float = float(np.deg2rad(15.0))  # modulo symmetry [rad]

    def __post_init__(self) -> None:
        if not 0 < self.translation < np.inf:
            raise ValueError(f"translation must be positive, got {self.translation}")
        if not 0 < self.rotation <= np.pi:
            raise ValueError(f"rotation must be in (0, pi] rad, got {self.rotation}")


def cluster_poses(
    T_cam_part: Floats, scores: Floats, part: PartModel, config: ClusterConfig | None = None
) -> tuple[NDArray[np.int64], Floats]:
    """Group poses about their best ones; each cluster is given by its best member, nothing is averaged.

    The best pose left is the head of the next cluster and takes every pose left that is near it: no pose of a cluster
    is better than its head, and no two heads are near each other.

    Args:
        T_cam_part: (K, 4, 4).
        scores: (K,) 0 or more, larger is better: votes, or a verdict's score.
        part: For its centre, diameter and symmetry.
        config: :class:`ClusterConfig`'s defaults if left out.

    Returns:
        The heads' indices (C,), and the (C,) sums of their clusters' scores, by which they are sorted, largest first.
        Ties go to the lower index.

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
    left = np.argsort(-scores, kind="stable")
    heads, sums = [], []
    while len(left):
        head = left[0]
        near = _near(head, left, centres, T_cam_part, part, config)
        near[0] = True
        heads.append(head)
        sums.append(float(scores[left[near]].sum()))
        left = left[~near]
    order = np.lexsort((heads, -np.array(sums)))
    return np.array(heads, np.int64)[order], np.array(sums, np.float64)[order]


def are_alike(
    T_cam_part: Floats, others: Floats, part: PartModel, config: ClusterConfig | None = None
) -> NDArray[np.bool_]:
    """Return (K,) whether each of (K, 4, 4) poses would be in the cluster of a (4, 4) one.

    Raises:
        ValueError: A shape is wrong.
    """
    require_shape("T_cam_part", T_cam_part, (4, 4))
    require_shape("others", others, (None, 4, 4))
    poses = np.concatenate([T_cam_part[None], others])
    places = np.arange(1, len(poses))
    return _near(0, places, transform_point_each(poses, part.centre), poses, part, config or ClusterConfig())


def _near(
    head: int, others: NDArray[np.int64], centres: Floats, poses: Floats, part: PartModel, config: ClusterConfig
) -> NDArray[np.bool_]:
    """Return (O,) whether ``others`` are within the limits of ``head``; both are indices into ``poses``."""
    near: NDArray[np.bool_] = np.linalg.norm(centres[others] - centres[head], axis=1) <= config.translation * part.d_max
    rotations = poses[others[near], :3, :3]
    near[near] = rotations_within(poses[head, :3, :3], rotations, part.symmetry, config.rotation)
    return near


def rotations_within(rotation: Floats, others: Floats, symmetry: Symmetry, limit: float) -> NDArray[np.bool_]:
    """Return (K,) whether each of (K, 3, 3) is within ``limit`` [rad] of a (3, 3) rotation modulo the symmetry.

    As :meth:`perception.part.Symmetry.distance`, for many at once; by cosines, so not for limits near 0.
    """
    images = rotation @ symmetry.rotations
    if symmetry.axis is None:
        cosines = (images.reshape(-1, 9) @ others.reshape(-1, 9).T - 1) / 2
    else:
        cosines = (images @ symmetry.axis) @ (others @ symmetry.axis).T
    within: NDArray[np.bool_] = cosines.max(axis=0) >= np.cos(limit)
    return within
