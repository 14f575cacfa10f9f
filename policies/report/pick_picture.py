"""The picture of one decision: the frame, its segments in colours, the pose and the jaw."""

from functools import lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from binpick_env.evaluation.pose.pictures import RIGHT, WRONG, outline
from binpick_env.evaluation.segmentation.pictures import prediction_colours
from binpick_env.evaluation.segmentation.record import STAGES, SceneRecord
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.pixel_perceiver import point_owners
from perception.frame import Frame
from perception.geometry import Floats, invert_transform, project_points, transform_points
from perception.instance import labels_of
from perception.part import PartModel
from perception.pose.model.appearances import SeenEdges, edge_appearances
from policies.evaluation.listeners import Decision
from policies.grasping.outcomes import GraspCandidate

if TYPE_CHECKING:
    from perception.pipeline import Perception

CROP = 0.17  # side of the square that is shown around a grasp [m]
CROP_PX = 640  # side of a picture [px]
_STROKE = 2  # width of a thin line [px]
BIN_MARGIN = 0.02  # width of the margin around the bin where all of it is shown [m]
Picture = NDArray[np.uint8]
Point = tuple[float, float, float]
Colour = tuple[int, int, int]  # BGR
_JAW, _APPROACH = (40, 140, 255), (255, 255, 255)  # orange and white, BGR
_PAD = 0.011  # half the width of a pad [m]
_APPROACH_LENGTH = 0.05  # drawn length of the approach [m]
_DIM = 0.7  # brightness of the frame under what is drawn on it
_FRACTION = 4  # number of fractional bits in the coordinates that OpenCV draws with


class Crop:
    """A square window of a frame that can be drawn on."""

    def __init__(self, frame: Frame, centre_world: Floats, edge: float) -> None:
        """Cut the square out of a frame.

        Args:
            frame: The frame.
            centre_world: (3,) point in the middle of the square [m].
            edge: Side of the square at the centre's distance from the camera [m].
        """
        self._T_cam_world = invert_transform(frame.T_world_cam)
        self._K = frame.K
        centre_cam = transform_points(self._T_cam_world, centre_world[None])
        self.scale = CROP_PX * float(centre_cam[0, 2]) / (float(frame.K[0, 0]) * edge)  # crop pixels a frame pixel
        self._shift = CROP_PX / 2 - self.scale * project_points(frame.K, centre_cam)[0]
        to_crop = np.column_stack([self.scale * np.eye(2), self._shift])
        way = cv2.INTER_AREA if self.scale < 1 else cv2.INTER_LINEAR
        grey = cv2.warpAffine(frame.grey, to_crop, (CROP_PX, CROP_PX), flags=way, borderValue=24)
        self.picture: Picture = np.repeat((_DIM * grey).astype(np.uint8)[:, :, None], 3, axis=2)

    def dots(self, pixels: NDArray[np.int64], colours: Picture) -> None:
        """Draw dots at (N, 2) pixels (u, v) of the frame in (N, 3) BGR colours."""
        radius = max(1, round(0.6 * self.scale))
        at = np.rint(self.scale * pixels + self._shift).astype(int)
        inside = ((at >= 0) & (at < CROP_PX)).all(axis=1)
        for centre, colour in zip(at[inside].tolist(), colours[inside].tolist(), strict=True):
            cv2.circle(self.picture, centre, radius, colour, cv2.FILLED)

    def strokes(self, ends: Floats, colour: Colour, thickness: int = 1) -> None:
        """Draw S strokes between (S, 2, 2) pixels (u, v) of the frame; thickness 1 is the thinnest line."""
        fixed = np.rint((self.scale * ends + self._shift) * (1 << _FRACTION)).astype(np.int32)
        cv2.polylines(self.picture, list(fixed), False, colour, _STROKE * thickness, cv2.LINE_AA, _FRACTION)

    def jaw(self, grasp: GraspCandidate) -> None:
        """Draw the open jaw (thin), the closed jaw (thick) and the last 5 cm of the approach."""
        self._line(grasp, (0.0, 0.0, -_APPROACH_LENGTH), (0.0, 0.0, 0.0), _APPROACH, 1)
        for gap, thickness in ((grasp.opening, 1), (grasp.width, 3)):
            half = gap / 2
            self._line(grasp, (0.0, -half, 0.0), (0.0, half, 0.0), _JAW, 1)
            for side in (-half, half):
                self._line(grasp, (-_PAD, side, 0.0), (_PAD, side, 0.0), _JAW, thickness)

    def _line(self, grasp: GraspCandidate, start: Point, end: Point, colour: Colour, thickness: int) -> None:
        """Draw a line between two points of the grasp frame [m]."""
        ends_world = transform_points(grasp.T_world_grasp, np.array([start, end]))
        ends = project_points(self._K, transform_points(self._T_cam_world, ends_world))
        self.strokes(ends[None], colour, thickness)


def draw_decision(decision: Decision, edges: SeenEdges) -> Picture:
    """Return the square BGR picture of a decision.

    An attempt's picture is centred on the grasp and shows the chosen candidate and the jaw. An abstention's picture
    shows the whole bin and all candidates. A segment has the colour of the part that it matches, and red and white
    stripes if it matches none. Outlines of correct poses are green, those of wrong poses red.

    Args:
        decision: The decision, with the frame that it was made on.
        edges: Edges of the part, as `part_edges` returns them.
    """
    labelled_capture, observed, grasp = decision.labelled_capture, decision.observed, decision.result.grasp
    recorded = decision.frame_record.candidates
    frame = labelled_capture.capture.frame
    if grasp is None:
        bin_edge = float(labelled_capture.workspace.inner_size[:2].max()) + 2 * BIN_MARGIN
        crop = Crop(frame, labelled_capture.workspace.T_world_bin[:3, 3], bin_edge)
        shown = list(range(len(recorded)))
    else:
        crop = Crop(frame, grasp.T_world_grasp[:3, 3], CROP)
        shown = [grasp.candidate]
    if observed.perception is not None:
        record = _scene_record(labelled_capture, observed.perception)
        crop.dots(record.pixels, prediction_colours(record))
    T_cam_world = invert_transform(frame.T_world_cam)
    for k in shown:
        T_cam_part = T_cam_world @ observed.candidates[k].T_world_part
        colour = RIGHT if recorded[k].right else WRONG
        crop.strokes(outline(T_cam_part, edges, frame.K, (0, 0)), colour, thickness=1 if grasp is None else 2)
    if grasp is not None:
        crop.jaw(grasp)
    return crop.picture


@lru_cache(maxsize=2)
def part_edges(part: PartModel) -> SeenEdges:
    """Return the edges of a part from all directions; takes seconds for a new part."""
    return edge_appearances(part)


def _scene_record(labelled_capture: LabelledCapture, perception: "Perception") -> SceneRecord:
    """Return the segments in the form that `prediction_colours` requires."""
    return SceneRecord(
        labels=labels_of(perception.segments, len(perception.boundary)),
        scores=np.array([segment.score for segment in perception.segments], np.float64),
        instance_ids=point_owners(labelled_capture, perception.boundary),
        visible_fractions=labelled_capture.visible_fractions,
        pixels=perception.boundary.pixels,
        picture=np.zeros((0, 0), np.uint8),
        corner=(0, 0),
        wrong_side=0,
        contour=0,
        ms=dict.fromkeys(STAGES, 0.0),
        threads=1,
        git_commit="",
    )
