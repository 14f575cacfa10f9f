"""Count the boundary points on the wrong side of a contour, by the true depth of a simulated capture."""

import numpy as np

from binpick_env.camera.depth_camera import Capture
from perception.boundary import BoundaryCloud

RADIUS = 2  # half the edge of the patch in which a contour is looked for [px]
STEP = 0.003  # smallest depth step that counts as a contour with two sides [m]


def wrong_side(capture: Capture, boundary: BoundaryCloud) -> tuple[int, int]:
    """Count the points on the wrong side of a contour, and all points at contours.

    A point is at a contour if its 5 x 5 patch shows two parts, or part and container. It is on the wrong side if the
    nearest true surface of the patch is nearer than its own by more than 3 mm and belongs to another body: an edge
    belongs to the nearer body.

    Args:
        capture: Capture with true depth and instance ids.
        boundary: Boundary points of the capture.

    Returns:
        Number of points on the wrong side, and number of points at contours.
    """
    height, width = capture.instance_ids.shape
    steps = np.arange(-RADIUS, RADIUS + 1)
    v = np.clip(boundary.pixels[:, 1, None, None] + steps[:, None], 0, height - 1)
    u = np.clip(boundary.pixels[:, 0, None, None] + steps, 0, width - 1)
    ids = capture.instance_ids[v, u].reshape(-1, steps.size**2)
    depths = capture.depth_true[v, u].reshape(-1, steps.size**2)
    depths = np.where(depths > 0, depths, np.float32(np.inf))
    middle = steps.size**2 // 2  # index of the point's own pixel; at the image's border other pixels are repeated
    own_id, own_depth = ids[:, middle], depths[:, middle]
    at_contour = (ids != own_id[:, None]).any(axis=1)
    front = np.argmin(depths, axis=1)[:, None]
    other = np.take_along_axis(ids, front, axis=1)[:, 0] != own_id
    nearer = np.take_along_axis(depths, front, axis=1)[:, 0] < own_depth - STEP
    return int(np.sum(at_contour & other & nearer)), int(np.sum(at_contour))
