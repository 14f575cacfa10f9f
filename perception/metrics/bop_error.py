"""Pose errors of the BOP benchmark: MSSD, MSPD and VSD, and the recall averaged over their thresholds.

Source: Hodan et al., "BOP Challenge 2020 on 6D Object Localization", ECCVW 2020, section 2.2. Poses are (4, 4) float64
``T_cam_part``. H, W image size, N vertices, T tolerances.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from perception.geometry import Floats, project_points, require_shape, rotation_about
from perception.metrics.pose_errors import require_diameter, require_pose
from perception.part import PartModel, Symmetry

VSD_DELTA = 0.015  # BOP's tolerance of visibility [m]
SHARES = tuple(round(0.05 * k, 2) for k in range(1, 11))  # BOP's tau and theta: 5 to 50 % of the diameter
STEPS = 360  # number of angles tried about an axis of revolution


@dataclass(frozen=True, kw_only=True)
class VsdTolerances:
    """Tolerances of the visible surface discrepancy; BOP's by default."""

    taus: tuple[float, ...] = SHARES  # T tolerances of the distance along a ray, as shares of the part's diameter
    delta: float = VSD_DELTA  # distance behind the measured surface up to which a pixel still shows the part [m]

    def __post_init__(self) -> None:
        if not (all(tau > 0 for tau in self.taus) and self.delta >= 0):
            raise ValueError(f"taus must be positive and delta 0 or more, got {self.taus} and {self.delta}")


def mssd(T_est: Floats, T_true: Floats, part: PartModel, *, steps: int = STEPS) -> float:
    """Return the maximum symmetry-aware surface distance [m].

    It is the largest distance between the positions of a vertex in the two poses, minimised over the symmetries of the
    part. The distance is convex along every triangle, so the vertices give the maximum over the surface.

    Args:
        T_est: (4, 4) estimated pose.
        T_true: (4, 4) true pose.
        part: Mesh, symmetry and centre of the part.
        steps: Number of angles tried about an axis of revolution; the best one is refined.

    Raises:
        ValueError: A pose is not (4, 4) and finite, or ``steps`` is below 1.

    Note:
        For a solid of revolution the result exceeds the minimum over all angles by at most ``2 r sin(pi / (2 steps))``,
        where r is the radius of the part about its axis: 0.9 % of r at 360 steps. BOP allows 1 % of the diameter.
    """
    require_pose(T_est, T_true)
    offsets, est = _vertices(T_est, part)
    centre_true = T_true[:3, :3] @ part.centre + T_true[:3, 3]

    def largest(element: Floats) -> float:
        true = offsets @ (T_true[:3, :3] @ element).T + centre_true
        return float(np.linalg.norm(est - true, axis=1).max())

    return _least(largest, part.symmetry, T_true[:3, :3].T @ T_est[:3, :3], steps)


def mspd(T_est: Floats, T_true: Floats, part: PartModel, K: Floats, *, steps: int = STEPS) -> float:
    """Return the maximum symmetry-aware projection distance [px]: `mssd` between the projections of the vertices.

    Args:
        T_est: (4, 4) estimated pose. The error is infinite if it has a vertex that is not in front of the camera.
        T_true: (4, 4) true pose.
        part: Mesh, symmetry and centre of the part.
        K: (3, 3) camera matrix [px].
        steps: Number of angles tried about an axis of revolution; the best one is refined.

    Raises:
        ValueError: A pose is not (4, 4) and finite, K is not (3, 3), ``steps`` is below 1, or the true pose has a
            vertex that is not in front of the camera.
    """
    require_pose(T_est, T_true)
    require_shape("K", K, (3, 3))
    offsets, est = _vertices(T_est, part)
    centre_true = T_true[:3, :3] @ part.centre + T_true[:3, 3]
    nearest = float((offsets @ T_true[:3, :3].T + centre_true)[:, 2].min())
    if not nearest > 0:
        raise ValueError(f"T_true must put the whole part in front of the camera, got z = {nearest}")
    if est[:, 2].min() <= 0:
        return np.inf
    pixels_est = project_points(K, est)

    def largest(element: Floats) -> float:
        pixels_true = project_points(K, offsets @ (T_true[:3, :3] @ element).T + centre_true)
        return float(np.linalg.norm(pixels_est - pixels_true, axis=1).max())

    return _least(largest, part.symmetry, T_true[:3, :3].T @ T_est[:3, :3], steps)


def vsd(
    depth_est: NDArray[np.floating],
    depth_true: NDArray[np.floating],
    depth_scene: NDArray[np.floating],
    K: Floats,
    d_max: float,
    tolerances: VsdTolerances = VsdTolerances(),
) -> Floats:
    """Return the (T,) visible surface discrepancy in [0, 1], one for each tolerance.

    Of the pixels that show the part in either pose, it is the share that does not show it in both poses, or shows it at
    distances along the ray that differ by the tolerance or more. A pixel shows the part if the part lies at most
    ``delta`` behind the measured scene, or if the scene has no depth there. In the estimated pose, a pixel also shows
    the part where it shows it in the true pose. The discrepancy is 1 if no pixel shows the part.

    Args:
        depth_est: (H, W) depth along z of the part alone in the estimated pose [m]; 0 or NaN off the part.
        depth_true: (H, W) depth along z of the part alone in the true pose [m]; 0 or NaN off the part.
        depth_scene: (H, W) measured depth [m]; 0 or NaN where there is none.
        K: (3, 3) camera matrix [px].
        d_max: Diameter of the part [m].
        tolerances: Tolerances of distance and visibility; BOP's unless given.

    Raises:
        ValueError: The images do not have the same shape (H, W), K is not (3, 3), or ``d_max`` is not positive.
    """
    require_shape("K", K, (3, 3))
    require_diameter(d_max)
    require_shape("depth_est", depth_est, (None, None))
    stretch = _ray_lengths(K, depth_est.shape)
    distances = []
    for name, depth in (("depth_est", depth_est), ("depth_true", depth_true), ("depth_scene", depth_scene)):
        require_shape(name, depth, depth_est.shape)
        distances.append(np.where(depth > 0, depth, 0.0).astype(np.float64) * stretch)
    est, true, scene = distances
    taus, delta = tolerances.taus, tolerances.delta

    shows_true = (true > 0) & ((true <= scene + delta) | (scene == 0))
    shows_est = (est > 0) & ((est <= scene + delta) | (scene == 0) | shows_true)
    both, either = shows_true & shows_est, int((shows_true | shows_est).sum())
    if either == 0:
        return np.ones(len(taus))
    apart = np.abs(est - true)[both]
    return np.array([(either - (apart < tau * d_max).sum()) / either for tau in taus])


def average_recall(errors: NDArray[np.floating], thresholds: Sequence[float]) -> float:
    """Return BOP's average recall: the share of errors strictly under a threshold, averaged over the thresholds.

    BOP's thresholds are `SHARES` times the diameter for MSSD, `SHARES` for VSD (over all instances and tolerances), and
    5, 10 ... 50 px times the width of the image / 640 for MSPD.

    Args:
        errors: Errors of the instances, in any shape; infinite for an instance without an estimate.
        thresholds: Thresholds in the unit of the errors.

    Raises:
        ValueError: There is no error or no threshold, or an error is NaN.
    """
    if errors.size == 0 or len(thresholds) == 0:
        raise ValueError(f"at least 1 error and 1 threshold are needed, got {errors.size} and {len(thresholds)}")
    if np.isnan(errors).any():
        raise ValueError("errors must not be NaN; an instance that was not found has an infinite error")
    return float(np.mean([(errors < threshold).mean() for threshold in thresholds]))


def _vertices(T_est: Floats, part: PartModel) -> tuple[Floats, Floats]:
    """Return the (N, 3) vertices about the part's centre, in part axes, and in the estimated pose."""
    offsets = np.asarray(part.mesh.vertices, np.float64) - part.centre
    return offsets, offsets @ T_est[:3, :3].T + (T_est[:3, :3] @ part.centre + T_est[:3, 3])


def _least(error_of: Callable[[Floats], float], symmetry: Symmetry, R_true_est: Floats, steps: int) -> float:
    """Return the least ``error_of`` over the (3, 3) elements of the symmetry group; for a ball, at equal rotations."""
    if steps < 1:
        raise ValueError(f"steps must be at least 1, got {steps}")
    if symmetry.sphere:
        return error_of(R_true_est)
    if symmetry.axis is None:
        return min(error_of(element) for element in symmetry.rotations)
    axis, width, least = symmetry.axis, 2 * np.pi / steps, np.inf
    for rotation in symmetry.rotations:

        def turned(angle: float, rotation: Floats = rotation) -> float:
            return error_of(rotation @ rotation_about(axis, angle))

        coarse = [turned(width * k) for k in range(steps)]
        best = width * int(np.argmin(coarse))
        fine = minimize_scalar(turned, bounds=(best - width, best + width), method="bounded", options={"xatol": 1e-9})
        least = min(least, *coarse, float(fine.fun))
    return least


def _ray_lengths(K: Floats, shape: tuple[int, ...]) -> Floats:
    """Return the (H, W) distance along each pixel's ray for a depth of 1."""
    u = (np.arange(shape[1]) - K[0, 2]) / K[0, 0]
    v = (np.arange(shape[0]) - K[1, 2]) / K[1, 1]
    lengths: Floats = np.sqrt(1.0 + u[None, :] ** 2 + v[:, None] ** 2)
    return lengths
