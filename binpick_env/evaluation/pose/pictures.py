"""A scene's groups in colours, and the outlines of the poses on its image: green for right, red for wrong."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from binpick_env.evaluation.pose.judgement import PoseScore
from binpick_env.evaluation.pose.record import PoseRecord
from binpick_env.evaluation.segmentation.pictures import JPEG_QUALITY, WIDTH, Panel, scene_panels
from perception.geometry import Floats, project_points, transform_points
from perception.pose.model.appearances import SeenEdges
from perception.pose.verification.refinement import view_direction

Picture = NDArray[np.uint8]
RIGHT, WRONG, MISSED = (90, 200, 40), (60, 50, 235), (40, 180, 245)  # BGR
DASH = 0.012  # of d_max: half the length of the stroke that an edge point is drawn as
_DIM = 0.75  # brightness of the image under outlines
_FRACTION = 4  # bits of a pixel's fraction that OpenCV draws with


def pose_panels(record: PoseRecord, score: PoseScore, edges: SeenEdges) -> list[Panel]:
    """Return the grey image and the outlines on it (where it was kept), and the groups in colours."""
    shown = {panel.name: panel for panel in scene_panels(record.segmentation())}
    groups = shown["truth" if record.whole_scene else "prediction"]
    named = groups._replace(name="true segments" if record.whole_scene else "groups")
    if not record.picture.size:
        return [named]
    _, data = cv2.imencode(".jpg", outlines(record, score, edges), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return [shown["image"], named, Panel("poses", "jpeg", data.tobytes())]


def outlines(record: PoseRecord, score: PoseScore, edges: SeenEdges) -> Picture:
    """Return (h, w, 3) BGR: the grey image with the verified poses' outlines over those of parts that were missed.

    Missed are the parts that have to be found and that no right pose is of; they lie in their true poses.

    Args:
        record: With its grey image.
        score: The verdicts on it.
        edges: Of the part.
    """
    step = max(1, -(-record.picture.shape[1] // WIDTH))
    small = cv2.resize(record.picture, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA)
    picture = np.repeat((_DIM * small).astype(np.uint8)[:, :, None], 3, axis=2)
    missed = np.flatnonzero(score.to_find & ~score.delivered.found)
    right, wrong = score.delivered.which[score.delivered.right], score.delivered.which[~score.delivered.right]
    for poses, colour in (
        (record.T_cam_parts[missed], MISSED),
        (record.poses[wrong], WRONG),
        (record.poses[right], RIGHT),
    ):
        for T in poses:
            # A picture's pixel is the mean of step by step pixels, whose centres are at integers.
            _draw(picture, (outline(T, edges, record.K, record.corner) - (step - 1) / 2) / step, colour)
    return picture


def outline(T_cam_part: Floats, edges: SeenEdges, K: Floats, corner: Sequence[int]) -> Floats:
    """Return the (S, 2, 2) ends (u, v) of strokes along the edges that a pose shows, from the picture's corner [px].

    Args:
        T_cam_part: (4, 4).
        edges: Of the part.
        K: (3, 3) of the camera.
        corner: Column and row of the picture's first pixel.
    """
    points, tangents = edges.seen_from(view_direction(T_cam_part, edges.centre))
    half = DASH * edges.d_max * tangents
    ends = transform_points(T_cam_part, np.stack([points - half, points + half], axis=1).reshape(-1, 3))
    pixels: Floats = project_points(K, ends) - np.asarray(corner)
    return pixels.reshape(-1, 2, 2)


def _draw(picture: Picture, strokes: Floats, colour: tuple[int, int, int]) -> None:
    """Draw strokes into the picture."""
    fixed = np.rint(strokes * (1 << _FRACTION)).astype(np.int32)
    cv2.polylines(picture, list(fixed), False, colour, 1, cv2.LINE_AA, _FRACTION)
