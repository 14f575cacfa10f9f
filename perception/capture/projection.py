"""Points projected into a camera."""

import numpy as np
from numpy.typing import NDArray

from perception.capture.filling import fill_from_nearest
from perception.geometry import NEAR, Floats, project_points


def project_cloud(
    points_cam: Floats, K: Floats, size: tuple[int, int], grey: NDArray[np.uint8] | None = None
) -> tuple[NDArray[np.float32], NDArray[np.uint8] | None]:
    """Return the depth and the grey image that a camera sees of points; the nearest point in a pixel wins.

    Args:
        points_cam: (N, 3) finite points in the camera frame [m]; those behind the camera or beside the image drop out.
        K: (3, 3) camera matrix [px].
        size: Width and height of the image [px].
        grey: (N,) uint8 grey value of each point; None if the points have none.

    Returns:
        (H, W) float32 depth [m], 0 where no point is seen, and the (H, W) grey image or None.
    """
    width, height = size
    depth = np.zeros((height, width), np.float32)
    image = None if grey is None else np.zeros((height, width), np.uint8)
    ahead = np.nonzero(points_cam[:, 2] > NEAR)[0]
    pixels = np.rint(project_points(K, points_cam[ahead]))
    seen = ((pixels >= 0) & (pixels < (width, height))).all(axis=1)
    order, (u, v) = ahead[seen], pixels[seen].astype(np.int64).T
    far_first = np.argsort(-points_cam[order, 2], kind="stable")  # the last write to a pixel stays
    order, u, v = order[far_first], u[far_first], v[far_first]
    depth[v, u] = points_cam[order, 2]
    if image is not None and grey is not None:
        image[v, u] = grey[order]
        if len(order):  # a hole takes the grey of the nearest pixel, so that it draws no edge
            image = fill_from_nearest(image, depth > 0)
    return depth, image
