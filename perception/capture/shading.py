"""A grey image for cameras that have none: the depth, shaded."""

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats

Pixel = TypeVar("Pixel", np.float32, np.uint8)
LIGHT_CAM = np.array([-0.4, -0.5, -0.77])  # direction to the light: from the upper left, behind the camera
DARKEST, BRIGHTEST = 30.0, 250.0  # grey of surfaces seen edge-on, and of those that face both the light and the camera
SMOOTHING = (1.5, 5.0)  # range of the standard deviation of the Gaussian before the normals are taken [px]
# Smoothing by s pixels leaves a slope noise of 0.2 sigma_z / s^2 per pixel. That is 22 fx sigma_z / (z s^2) grey
# levels, and 8 / s times as much in the edge detector. Its weak threshold of 15 is three times that where
# s^3 = 37 fx sigma_z / z. The noise of neighbouring pixels is alike, which needs more.
SLOPE_NOISE = 100.0
REACH = 3.5  # standard deviations of the Gaussian up to which a step of 0.1 m shows in the shade
STEP_NOISE, STEP_PITCH = 8.0, 4.0  # a depth step exceeds these multiples of the noise and of a pixel's width


def shade_depth(depth: NDArray[np.float32], K: Floats) -> NDArray[np.uint8]:
    """Return an (H, W) uint8 grey image of the measured surface, lit from the upper left.

    Boundary extraction finds edges in the grey image only: an image of zeros has none. The grey is the product of the
    normal's cosines with the light and with the optical axis, so that creases are steps of grey. Depth steps are dark
    lines on the nearer surface. The depth is smoothed as much as its noise asks for. Pixels without depth, and those
    beside a step whose smoothing mixes two surfaces, take the grey of the nearest other pixel.

    Args:
        depth: (H, W) float32 depth [m], 0 where there is no measurement.
        K: (3, 3) camera matrix [px].
    """
    valid = depth > 0
    if not valid.any() or min(depth.shape) < 2:
        return np.zeros(depth.shape, np.uint8)
    filled = fill_from_nearest(depth, valid)
    noise = _noise(filled, valid)
    near, far = _step_sides(filled, np.maximum(STEP_NOISE * noise * filled**2, STEP_PITCH / K[0, 0] * filled))
    middle = float(np.median(depth[valid]))
    smoothing = float(np.clip(np.cbrt(SLOPE_NOISE * K[0, 0] * noise * middle), *SMOOTHING))
    shade = _shade(np.asarray(cv2.GaussianBlur(filled, (0, 0), smoothing)), K)
    to_step = cv2.distanceTransform((~(near | far)).astype(np.uint8), cv2.DIST_L2, 5)
    pure = valid & (to_step > REACH * smoothing)
    grey = fill_from_nearest(shade, pure if pure.any() else valid)
    return np.where(near & valid, np.uint8(DARKEST), grey)


def _noise(filled: NDArray[np.float32], valid: NDArray[np.bool_]) -> float:
    """Return the standard deviation of the depth at 1 m [m]; that of triangulating cameras grows with its square."""
    rough = (filled - np.asarray(cv2.GaussianBlur(filled, (0, 0), 3.0)))[valid] / filled[valid] ** 2
    return 1.4826 * float(np.median(np.abs(rough)))


def _step_sides(
    filled: NDArray[np.float32], least: NDArray[np.floating]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the (H, W) masks of the nearer and the farther pixels of steps of at least ``least`` (H, W) [m]."""
    near, far = np.zeros(filled.shape, bool), np.zeros(filled.shape, bool)
    for first, second in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        rise = filled[second] - filled[first]
        up, down = rise > least[first], -rise > least[second]
        near[first] |= up
        far[second] |= up
        near[second] |= down
        far[first] |= down
    return near, far


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


def fill_from_nearest(image: NDArray[Pixel], valid: NDArray[np.bool_]) -> NDArray[Pixel]:
    """Return an (H, W) image whose pixels outside the mask have the value of the nearest pixel inside, which exists."""
    if valid.all():
        return image
    labels = cv2.distanceTransformWithLabels((~valid).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)[
        1
    ]
    value_of = np.zeros(int(labels.max()) + 1, image.dtype)
    value_of[labels[valid]] = image[valid]
    filled: NDArray[Pixel] = value_of[labels]
    return filled
