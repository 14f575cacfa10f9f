"""The camera matrix that explains an organised cloud."""

from dataclasses import dataclass

import numpy as np

from perception.capture.cloud import measured
from perception.geometry import NEAR, Floats, project_points

SAMPLES = 20_000  # points that the camera matrix is fitted to; more do not change it, and take longer
EXPLAINED = 0.5  # largest root mean square residual of a cloud that a pinhole camera explains [px]


@dataclass(frozen=True, eq=False, kw_only=True)
class PinholeFit:
    """A camera matrix and how well it explains a cloud.

    Attributes:
        K: (3, 3) camera matrix [px].
        residual: Root mean square distance between the points' projections and their pixels [px].
    """

    K: Floats
    residual: float


def fit_pinhole(points_cam: Floats) -> PinholeFit:
    """Return the camera matrix that maps the points of an organised cloud to their pixels best, by least squares.

    Args:
        points_cam: (H, W, 3) organised cloud in the camera frame; points that are not finite or zero are left out.

    Raises:
        ValueError: Too few points lie in front of the camera, or they lie in one row, one column, or one direction.
    """
    pixels, points = _pairs(points_cam)
    front = points[:, 2] > NEAR
    if np.count_nonzero(front) < max(4, len(points) / 2):
        raise ValueError(
            f"an organised cloud must have its points in front of the camera (z > 0), got {np.count_nonzero(front)} of "
            f'{len(points)} points there: if z points backwards, set axes="opengl" (--axes opengl on the command line)'
        )
    pixels, points = pixels[front], points[front]
    focal, centre, errors = [], [], []
    for axis in (0, 1):
        slope = points[:, axis] / points[:, 2]
        if np.ptp(slope) == 0 or np.ptp(pixels[:, axis]) == 0:
            raise ValueError("an organised cloud must cover several rows and columns to recover K: state K")
        design = np.column_stack([slope, np.ones(len(slope))])
        (f, c), *_ = np.linalg.lstsq(design, pixels[:, axis], rcond=None)
        focal.append(float(f))
        centre.append(float(c))
        errors.append(design @ (f, c) - pixels[:, axis])
    residual = float(np.sqrt(np.mean(errors[0] ** 2 + errors[1] ** 2)))
    K = np.array([[focal[0], 0, centre[0]], [0, focal[1], centre[1]], [0, 0, 1]])
    return PinholeFit(K=K, residual=residual)


def residual_of(K: Floats, points_cam: Floats) -> float:
    """Return the root mean square distance [px] between pixels and projections of an organised cloud; 0 if it is empty.

    It is infinite if all points lie behind the camera.

    Args:
        K: (3, 3) camera matrix [px].
        points_cam: (H, W, 3) organised cloud in the camera frame.
    """
    if not measured(points_cam).any():
        return 0.0
    pixels, points = _pairs(points_cam)
    front = points[:, 2] > NEAR
    if not front.any():
        return float("inf")
    errors = project_points(K, points[front]) - pixels[front]
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def require_pinhole(fit: PinholeFit) -> None:
    """Raise ``ValueError`` unless a pinhole camera with positive focal lengths explains the cloud."""
    if fit.residual > EXPLAINED:
        raise ValueError(
            f"an organised cloud must be explained by a pinhole camera to {EXPLAINED} px (root mean square), got a "
            f"residual of {fit.residual:.2f} px with K = {np.round(fit.K, 2).tolist()}: if the lens distorts, or the "
            "points are in another frame, state the calibration and set project=True (--project on the command "
            "line), or give the points in the camera's frame"
        )
    if fit.K[0, 0] <= 0 or fit.K[1, 1] <= 0:
        raise ValueError(
            "an organised cloud must have x to the right and y down, got the focal lengths "
            f'{fit.K[0, 0]:.1f} and {fit.K[1, 1]:.1f} px: set axes="opengl" (--axes opengl on the command '
            "line) if y points up, or store the rows from the top and the columns from the left"
        )


def _pairs(points_cam: Floats) -> tuple[Floats, Floats]:
    """Return the (N, 2) pixels and the (N, 3) points of what was measured, thinned evenly to at most `SAMPLES`."""
    v, u = np.nonzero(measured(points_cam))
    if len(u) == 0:
        raise ValueError("an organised cloud must hold measured points, got none: state K to read it as empty")
    every = -(-len(u) // SAMPLES)
    v, u = v[::every], u[::every]
    return np.column_stack([u, v]).astype(np.float64), points_cam[v, u]
