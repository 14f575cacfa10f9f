"""The verified poses of a frame as outlines on its grey image, or on its shaded depth."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from binpick_env.evaluation.pose.pictures import RIGHT, draw_strokes, outline
from perception.geometry import project_points, transform_points
from perception.runtime.files import write_bytes_atomically
from policies.frames.frame_record import FrameRecord
from policies.frames.shading import shown_grey

DIM = 0.75  # factor on the image's brightness under outlines
_LABEL = 0.5  # size of the numbers, relative to OpenCV's font


def draw_poses(record: FrameRecord) -> NDArray[np.uint8]:
    """Draw the visible edges of the verified poses on the grey image, with their numbers in the table.

    Without a grey image, they are drawn on the shaded depth.

    Args:
        record: What was found in the frame.

    Returns:
        (H, W, 3) uint8 BGR picture of the frame's size.
    """
    frame, estimator = record.frame, record.perceiver.estimator
    picture = np.repeat((DIM * shown_grey(frame)).astype(np.uint8)[:, :, None], 3, axis=2)
    for number, pose in enumerate(record.seen.poses, start=1):
        draw_strokes(picture, outline(pose.T_cam_part, estimator.appearances, frame.K, (0, 0)), RIGHT)
        middle = transform_points(pose.T_cam_part, estimator.part.centre[None])
        u, v = np.rint(project_points(frame.K, middle)[0]).astype(int).tolist()
        cv2.putText(picture, str(number), (u, v), cv2.FONT_HERSHEY_SIMPLEX, _LABEL, RIGHT, 1, cv2.LINE_AA)
    return picture


def save_picture(picture: NDArray[np.uint8], path: Path) -> None:
    """Write an (H, W, 3) uint8 BGR picture as PNG, atomically; folders that are missing are created."""
    _, encoded = cv2.imencode(".png", picture)
    write_bytes_atomically(path, encoded.tobytes())
