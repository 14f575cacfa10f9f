"""A grey image for cameras that have none: the depth, shaded."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from perception.geometry import Floats, deproject_depth

LIGHT_CAM = np.array([-0.4, -0.5, -0.77])  # direction to the light: from the upper left, behind the camera
DARKEST, BRIGHTEST = 30.0, 250.0  # grey of surfaces that face away from the light and towards it
SMOOTHING = 1.5  # standard deviation of the Gaussian before the normals are taken [px]


def shade_depth(depth: NDArray[np.float32], K: Floats) -> NDArray[np.uint8]:
    """Return an (H, W) uint8 grey image of the measured surface, lit from the upper left.

    Boundary extraction finds edges in the grey image only: an image of zeros has none. In the shaded image creases are
    steps of grey and depth steps dark lines. Pixels without depth take the depth of the nearest pixel that has one.

    Args:
        depth: (H, W) float32 depth [m], 0 where there is no measurement.
        K: (3, 3) camera matrix [px].
    """
    valid = depth > 0
    if not valid.any() or min(depth.shape) < 2:
        return np.zeros(depth.shape, np.uint8)
    nearest = distance_transform_edt(~valid, return_distances=False, return_indices=True)
    filled = depth[tuple(nearest)].astype(np.float64)
    points_cam = deproject_depth(K, np.asarray(cv2.GaussianBlur(filled, (0, 0), SMOOTHING)))
    normals_cam = np.cross(np.gradient(points_cam, axis=0), np.gradient(points_cam, axis=1))  # towards the camera
    lengths = np.maximum(np.linalg.norm(normals_cam, axis=-1), 1e-300)
    cosine = normals_cam @ (LIGHT_CAM / np.linalg.norm(LIGHT_CAM)) / lengths
    grey: NDArray[np.uint8] = np.rint(DARKEST + (BRIGHTEST - DARKEST) * np.clip(cosine, 0, 1)).astype(np.uint8)
    return grey
