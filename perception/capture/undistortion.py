"""Lens distortion removed from registered images."""

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.capture.calibration import Calibration


def undistort(
    grey: NDArray[np.uint8] | None, depth: NDArray[np.float32], calibration: Calibration
) -> tuple[NDArray[np.uint8] | None, NDArray[np.float32]]:
    """Return the images of a pinhole camera with the same camera matrix.

    The grey image is interpolated linearly. Each depth is that of the nearest pixel, so that no depth lies between two
    surfaces. Where a pixel saw nothing, its depth is 0 and its grey that of the image's border.

    Args:
        grey: (H, W) uint8 grey image; None if there is none.
        depth: (H, W) float32 depth [m].
        calibration: Camera matrix and distortion.
    """
    if not calibration.distortion.any():
        return grey, depth
    height, width = depth.shape
    K = calibration.K
    map_u, map_v = cv2.initUndistortRectifyMap(K, calibration.distortion, np.eye(3), K, (width, height), cv2.CV_32FC1)
    straight = cv2.remap(depth, map_u, map_v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    if grey is not None:
        grey = np.asarray(cv2.remap(grey, map_u, map_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8)
    return grey, np.asarray(straight, np.float32)
