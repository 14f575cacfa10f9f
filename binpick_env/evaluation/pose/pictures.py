"""Pictures of a scene: its groups in colours, and outlines of the poses, green for correct and red for wrong."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from binpick_env.evaluation.pose.record import PoseRecord
from binpick_env.evaluation.pose.scene_score import PoseSceneScore
from binpick_env.evaluation.segmentation.pictures import JPEG_QUALITY, WIDTH, Panel, scene_panels
from perception.geometry import Floats, project_points, transform_points
from perception.pose.model.appearances import SeenEdges
from perception.pose.verification.refinement import view_direction

Picture = NDArray[np.uint8]
RIGHT, WRONG, MISSED = (90, 200, 40), (60, 50, 235), (40, 180, 245)  # BGR
DASH = 0.012  # half the length of the stroke that represents an edge point [d_max]
_DIM = 0.75  # factor on the image's brightness under outlines
_FRACTION = 4  # fractional bits of the pixel coordinates that OpenCV draws with


def pose_panels(record: PoseRecord, score: PoseSceneScore, edges: SeenEdges) -> list[Panel]:
    """Return panels of the groups in colours and, if the image was kept, of the image and of the poses on it."""
    shown = {panel.name: panel for panel in scene_panels(record.segmentation())}
    groups = shown["truth" if record.whole_scene else "prediction"]
    titled = groups._replace(name="true segments" if record.whole_scene else "groups")
    if not record.picture.size:
        return [titled]
    _, data = cv2.imencode(".jpg", outlines(record, score, edges), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return [shown["image"], titled, Panel("poses", "jpeg", data.tobytes())]


def outlines(record: PoseRecord, score: PoseSceneScore, edges: SeenEdges) -> Picture:
    """Draw the verified poses on the grey image, over the true poses of missed parts.

    A part is missed if its visible fraction is at least 0.5 and no verified pose is correct for it.

    Args:
        record: Record of the scene, with its grey image.
        score: Score of the record.
        edges: Edges of the part that are visible from each direction.

    Returns:
        (h, w, 3) uint8 BGR picture.
    """
    step = max(1, -(-record.picture.shape[1] // WIDTH))
    small = cv2.resize(record.picture, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA)
    picture = np.repeat((_DIM * small).astype(np.uint8)[:, :, None], 3, axis=2)
    missed = np.flatnonzero(score.to_find & ~score.verified.found)
    right, wrong = score.verified.pose_idx[score.verified.correct], score.verified.pose_idx[~score.verified.correct]
    for poses, colour in (
        (record.T_cam_parts[missed], MISSED),
        (record.poses[wrong], WRONG),
        (record.poses[right], RIGHT),
    ):
        for T in poses:
            # A pixel of the picture is the mean of step x step pixels of the image, whose centres are at integers.
            draw_strokes(picture, (outline(T, edges, record.K, record.corner) - (step - 1) / 2) / step, colour)
    return picture


def outline(T_cam_part: Floats, edges: SeenEdges, K: Floats, corner: Sequence[int]) -> Floats:
    """Return strokes along the edges that are visible in a pose.

    Args:
        T_cam_part: (4, 4) pose of the part in the camera frame.
        edges: Edges of the part that are visible from each direction.
        K: (3, 3) camera matrix [px].
        corner: Column and row of the picture's first pixel in the camera's image.

    Returns:
        (S, 2, 2) both ends (u, v) of each stroke, relative to the corner [px].
    """
    points, tangents = edges.seen_from(view_direction(T_cam_part, edges.centre))
    half = DASH * edges.d_max * tangents
    ends = transform_points(T_cam_part, np.stack([points - half, points + half], axis=1).reshape(-1, 3))
    pixels: Floats = project_points(K, ends) - np.asarray(corner)
    return pixels.reshape(-1, 2, 2)


def draw_strokes(picture: Picture, strokes: Floats, colour: tuple[int, int, int]) -> None:
    """Draw strokes into the picture."""
    fixed = np.rint(strokes * (1 << _FRACTION)).astype(np.int32)
    cv2.polylines(picture, list(fixed), False, colour, 1, cv2.LINE_AA, _FRACTION)
