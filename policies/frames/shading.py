"""What pictures of a frame show: its grey image, or the shaded depth where the camera took none."""

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.capture.filling import fill_from_nearest
from perception.depth_edges import depth_noise
from perception.frame import Frame
from perception.geometry import Floats

LIGHT_CAM = np.array([-0.4, -0.5, -0.77])  # direction to the light: from the upper left, behind the camera
DARKEST, BRIGHTEST = 30.0, 250.0  # grey of surfaces seen edge-on, and of those that face both the light and the camera
GRAIN = 4.0  # noise of the shade that smoothing leaves, as a standard deviation [grey levels]
SMOOTHING = (0.8, 5.0)  # range of the standard deviation of the Gaussian before the normals are taken [px]
_ROWS = 4  # every such row tells the noise


def shown_grey(frame: Frame) -> NDArray[np.uint8]:
    """Return the (H, W) uint8 image that pictures of a frame show: its grey image, or the shaded depth without one."""
    return frame.grey if frame.has_grey else shade_depth(frame.depth, frame.K)


def shade_depth(depth: NDArray[np.float32], K: Floats) -> NDArray[np.uint8]:
    """Return an (H, W) uint8 picture of the measured surface, lit from the upper left.

    The grey is the product of the normal's cosines with the light and with the optical axis, so that steps of the depth
    are dark. The depth is smoothed as much as its noise asks for. Pixels without depth are filled from the nearest
    others; the picture is black if there are none.

    Args:
        depth: (H, W) float32 depth [m], 0 where there is no measurement.
        K: (3, 3) camera matrix [px].
    """
    valid = depth > 0
    if not valid.any() or min(depth.shape) < 2:
        return np.zeros(depth.shape, np.uint8)
    # Smoothing by s pixels leaves a slope noise of 0.2 sigma_z / s^2 per pixel: 22 fx sigma_z / (z s^2) grey levels.
    with np.errstate(all="ignore"):  # squares of absurd depths underflow or overflow
        noise = depth_noise(depth[::_ROWS]) * float(np.median(depth[valid]))
        wanted = float(np.sqrt(22 * K[0, 0] * noise / GRAIN))
    smoothing = float(np.clip(wanted, *SMOOTHING)) if np.isfinite(wanted) else SMOOTHING[0]
    return _shade(np.asarray(cv2.GaussianBlur(fill_from_nearest(depth, valid), (0, 0), smoothing)), K)


def _shade(z: NDArray[np.float32], K: Floats) -> NDArray[np.uint8]:
    """Return the (H, W) grey image of a surface without holes."""
    dz_dv, dz_du = np.gradient(z)
    (fx, fy), (cx, cy) = K[[0, 1], [0, 1]].astype(np.float32), K[:2, 2].astype(np.float32)
    u = np.arange(z.shape[1], dtype=np.float32) - cx
    v = np.arange(z.shape[0], dtype=np.float32)[:, None] - cy
    # The cross product of the derivatives of the point (u z / fx, v z / fy, z) by v and by u, times fx fy / z.
    x, y, along = fx * dz_du, fy * dz_dv, -(z + u * dz_du + v * dz_dv)
    squares = np.maximum(x * x + y * y + along * along, np.float32(1e-30))
    light = (LIGHT_CAM / np.linalg.norm(LIGHT_CAM)).astype(np.float32)
    towards_light = np.maximum(light[0] * x + light[1] * y + light[2] * along, 0)
    share = towards_light * np.abs(along) / squares
    shade: NDArray[np.uint8] = np.rint(DARKEST + (BRIGHTEST - DARKEST) * share).astype(np.uint8)
    return shade
