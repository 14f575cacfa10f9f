"""Structure that only the model or only the scene has, where a pose fits nearly everywhere else.

A pose of a mirrored part is an example. What shows that it is wrong is a rib of the model that the camera saw through,
and a rib of the scene that stands where the model has none. Both are small shares of the part, and count for little
among all samples. But samples that noise brings forth are scattered, and the points of a right pose lie on the model.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from perception.frame import Frame
from perception.geometry import Floats, project_points, transform_points
from perception.pose.model.surface_models import SurfaceModel
from perception.pose.verification import _refine_kernels
from perception.pose.verification.verification import ObservedGroup, VerificationConfig, surface_tolerance

BESIDE = 1.7  # distance up to which two samples are beside each other, in spacings of the samples
BEFORE = 1.2  # distance in the image up to which a point is before a sample, in spacings of the samples
OFF = 1.5  # distance from the model from which a point is not on it, in spacings of the samples
NOISE = 3.0  # deviation of a measured depth that noise explains, in standard deviations of the frame's depth
DEEPEST = 0.3  # distance before the surface up to which a point may belong to the same part, as a share of d_max


@dataclass(frozen=True, kw_only=True)
class Mismatch:
    """What only the model or only the scene has.

    Attributes:
        patch: Number of samples in the largest patch of the surface that the camera saw through.
        stray: Share of the group's boundary points that stand before the part's surface, on nothing that it has. Those
            off the part, but not before it, are subtracted.
    """

    patch: int = 0
    stray: float = 0.0


def find_mismatch(
    T_cam_part: Floats, surface: SurfaceModel, group: ObservedGroup, config: VerificationConfig
) -> Mismatch:
    """Return what only the model or only the scene has in a pose.

    What the noise of the depth explains does not count: gaps of up to three of its standard deviations, and boundary
    points up to six of them off the part.

    Args:
        T_cam_part: (4, 4) pose of the part in the camera frame.
        surface: Samples of the part's surface.
        group: Boundary points that the pose has to explain, and their frame.
        config: Tolerances.

    Note:
        Takes about a millisecond.
    """
    tolerance = max(surface_tolerance(surface.d_max, config), NOISE * group.noise)
    return Mismatch(
        patch=_largest_patch(T_cam_part, surface, group.frame, tolerance, config.window),
        stray=_stray_share(T_cam_part, surface, group, tolerance),
    )


def _largest_patch(T_cam_part: Floats, surface: SurfaceModel, frame: Frame, tolerance: float, window: int) -> int:
    """Return the number of connected samples that are visible in the pose, but lie before everything measured there."""
    visible = surface.visible(T_cam_part)
    gaps = _refine_kernels.surface_gaps(
        T_cam_part, surface.points, surface.normals, visible, frame.depth, frame.K, window
    )
    points = surface.points[np.nan_to_num(gaps, nan=-np.inf) > tolerance]
    if len(points) < 2:
        return len(points)
    pairs = cKDTree(points).query_pairs(BESIDE * surface.spacing, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    return int(np.bincount(connected_components(graph, directed=False)[1]).max())


def _stray_share(T_cam_part: Floats, surface: SurfaceModel, group: ObservedGroup, tolerance: float) -> float:
    """Return the share of the group's points that are seen before the part's visible surface, but off the part."""
    samples_cam = transform_points(T_cam_part, surface.points)
    visible = surface.visible(T_cam_part) & (samples_cam[:, 2] > 0)
    points_cam = group.points_cam
    if len(points_cam) == 0 or not visible.any():
        return 0.0
    K, seen = group.frame.K, samples_cam[visible]
    away, nearest = cKDTree(project_points(K, seen)).query(project_points(K, points_cam))
    over = away < BEFORE * surface.spacing * K[0, 0] / float(np.median(seen[:, 2]))
    height = np.einsum(
        "ni,ni->n", points_cam - seen[nearest], (surface.normals[visible] @ T_cam_part[:3, :3].T)[nearest]
    )
    over &= (height > 0) & (height < DEEPEST * surface.d_max)
    distance, _ = cKDTree(samples_cam).query(points_cam)
    foreign = distance > max(2 * tolerance, OFF * surface.spacing)
    # As many points beside the part tell that the group holds another part, which may lie across this one.
    excess = int(np.count_nonzero(foreign & over)) - int(np.count_nonzero(foreign & ~over))
    return max(excess, 0) / len(points_cam)
