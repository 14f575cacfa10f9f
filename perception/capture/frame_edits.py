"""Crops and quarter turns of frames; the camera matrix and the pose follow, so that points stay where they are."""

import numpy as np

from perception.capture.calibration import require_inside
from perception.frame import Frame

# (4, 4) pose of the camera turned by a quarter, anticlockwise as np.rot90 turns images, in the camera before.
T_CAM_TURNED = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def crop_frame(frame: Frame, u0: int, v0: int, width: int, height: int) -> Frame:
    """Return the part of a frame that a rectangle of pixels shows.

    Args:
        frame: Whole frame.
        u0: Column of the first pixel kept.
        v0: Row of the first pixel kept.
        width: Columns kept.
        height: Rows kept.

    Raises:
        ValueError: The rectangle is not of whole pixels, or does not lie in the image.
    """
    size = (frame.depth.shape[1], frame.depth.shape[0])
    u0, v0, width, height = require_inside((u0, v0, width, height), size)
    K = frame.K.copy()
    K[:2, 2] -= (u0, v0)
    window = np.s_[v0 : v0 + height, u0 : u0 + width]
    return Frame(grey=frame.grey[window], depth=frame.depth[window], K=K, T_world_cam=frame.T_world_cam)


def turn_frame(frame: Frame, quarter_turns: int) -> Frame:
    """Return a frame whose image is turned anticlockwise by quarter turns, as ``np.rot90`` turns it.

    Args:
        frame: Frame as the camera took it.
        quarter_turns: Number of quarter turns; negative ones are clockwise.
    """
    for _ in range(quarter_turns % 4):
        (fx, fy), (cx, cy) = frame.K[[0, 1], [0, 1]], frame.K[:2, 2]
        frame = Frame(
            grey=np.ascontiguousarray(np.rot90(frame.grey)),
            depth=np.ascontiguousarray(np.rot90(frame.depth)),
            K=np.array([[fy, 0, cy], [0, fx, frame.depth.shape[1] - 1 - cx], [0, 0, 1]]),
            T_world_cam=frame.T_world_cam @ T_CAM_TURNED,
        )
    return frame
