"""From a cloud to the depth and grey image of a pinhole camera."""

import logging
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from perception.capture.calibration import Calibration
from perception.capture.cloud import Cloud
from perception.capture.options import Axes
from perception.capture.pinhole import fit_pinhole, require_pinhole, residual_of
from perception.capture.projection import project_cloud
from perception.frame import FARTHEST
from perception.geometry import Floats, invert_transform, transform_points

STATED = 1.0  # largest root mean square residual of a cloud in the camera that the caller states [px]
_log = logging.getLogger(__name__)
FLIPPED = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's camera axes in OpenCV's, and the other way round


@dataclass(frozen=True, eq=False, kw_only=True)
class CloudImages:
    """Images of a cloud.

    Attributes:
        depth: (H, W) float32 depth [m].
        grey: (H, W) uint8 grey image of the cloud's colours; None if it has none.
        K: (3, 3) camera matrix [px].
        T_world_cam: (4, 4) camera pose that the cloud states; None if it states none.
        residual: Root mean square residual of the camera matrix [px]; None for a projected cloud.
        unseen: Number of measured points that the images do not show.
    """

    depth: NDArray[np.float32]
    grey: NDArray[np.uint8] | None
    K: Floats
    T_world_cam: Floats | None
    residual: float | None
    unseen: int


def images_of_cloud(
    cloud: Cloud, calibration: Calibration | None, *, scale: float, axes: Axes, project: bool
) -> CloudImages:
    """Return the images that a pinhole camera takes of a cloud. Coordinates of at least `FARTHEST` are no measurements.

    Args:
        cloud: Points in the camera frame, or in the frame in which its viewpoint is the camera's pose.
        calibration: Camera of the cloud; None recovers it from an organised one.
        scale: Length of one unit of the coordinates [m].
        axes: Convention of the cloud's axes.
        project: Whether an organised cloud is projected like an unorganised one.

    Raises:
        ValueError: No pinhole camera explains an organised cloud, or no camera is stated for another one.
    """
    far: NDArray[np.bool_] = np.abs(cloud.points).max(axis=2) >= FARTHEST / scale
    if far.any():
        if not (cloud.measured & ~far).any():
            _log.warning(
                "all points of the cloud lie %.0e m or more away and count as missing: is scale right (0.001 for "
                "millimetres)? It is --depth-scale on the command line",
                FARTHEST,
            )
        cloud = replace(cloud, points=np.where(far[..., None], np.nan, cloud.points))
    points_cam, T_world_cam = _in_camera_frame(cloud, scale, axes)
    known = cloud.measured
    if project or not cloud.organised:
        if calibration is None or calibration.size is None:
            raise ValueError(
                f"an unorganised cloud ({cloud.points.shape[1]} points in one row) or project=True needs a calibration "
                f"with K and size, got {calibration}: state Calibration(K=..., size=(width, height)) (--calibration on "
                "the command line), or ReadOptions(grid=...) (--grid) if the points lie in a grid that the file does "
                "not state"
            )
        grey = None if cloud.grey is None else cloud.grey[known]
        depth, image = project_cloud(points_cam[known], calibration.K, calibration.size, grey)
        unseen = int(np.count_nonzero(known) - np.count_nonzero(depth))
        return CloudImages(
            depth=depth, grey=image, K=calibration.K, T_world_cam=T_world_cam, residual=None, unseen=unseen
        )
    depth = np.where(known, points_cam[:, :, 2], 0).astype(np.float32)
    if calibration is None:
        fit = fit_pinhole(points_cam)
        require_pinhole(fit)
        K, residual = fit.K, fit.residual
    else:
        K, residual = calibration.K, residual_of(calibration.K, np.where(known[..., None], points_cam, np.nan))
        if residual > STATED:
            raise ValueError(
                f"the stated K must explain the organised cloud to {STATED} px (root mean square), got {residual:.2f} "
                "px: leave it out to recover K from the cloud, or set project=True (--project on the command line)"
            )
    return CloudImages(depth=depth, grey=cloud.grey, K=K, T_world_cam=T_world_cam, residual=residual, unseen=0)


def _in_camera_frame(cloud: Cloud, scale: float, axes: Axes) -> tuple[Floats, Floats | None]:
    """Return the (H, W, 3) points in the camera frame [m] and the camera's pose, if the cloud states one.

    PCL has two readings of VIEWPOINT. Its normals and range images take the points to be in the frame in which it is
    the sensor's pose; its viewer takes them to be in the sensor's frame. An organised cloud tells which one holds,
    because a camera matrix explains only one. An unorganised cloud is read in the first way.
    """
    points = np.where(cloud.measured[..., None], cloud.points * scale, np.nan)
    pose = cloud.viewpoint
    flip = FLIPPED if axes == "opengl" else np.eye(4)
    if pose is not None:
        pose = pose.copy()
        pose[:3, 3] *= scale
        moved = transform_points(invert_transform(pose), points.reshape(-1, 3)).reshape(points.shape)
        stays = cloud.organised and _misfit(points @ flip[:3, :3]) < _misfit(moved @ flip[:3, :3])
        points, pose = (points if stays else moved), pose @ flip
    return points @ flip[:3, :3], pose


def _misfit(points_cam: Floats) -> float:
    try:
        return fit_pinhole(points_cam).residual
    except ValueError:
        return float("inf")
