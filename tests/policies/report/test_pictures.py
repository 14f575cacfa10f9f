"""What the picture of a decision shows, and the file that it is written to."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from binpick_env.evaluation.pose.pictures import RIGHT, WRONG
from binpick_env.evaluation.segmentation.pictures import part_colours
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates
from perception.geometry import make_transform
from policies.evaluation.frame_record import record_frame
from policies.evaluation.listeners import Decision
from policies.grasping.outcomes import Abstention, GraspCandidate, GraspOutcome, PickResult
from policies.report import pictures
from policies.report.pick_picture import CROP, CROP_PX, Crop, draw_decision
from policies.report.pictures import Album
from tests.policies.fake_cell import BLOCK, candidate, frame, grasp, labelled_capture, observed


class Corners:
    """Edges of a block: the four of its upper face, each by its middle and its direction."""

    centre = BLOCK.centre
    d_max = BLOCK.d_max

    def seen_from(self, direction_part: NDArray[np.float64]) -> tuple[Any, Any]:
        middles = [(0.025, 0, 0.01), (-0.025, 0, 0.01), (0, 0.015, 0.01), (0, -0.015, 0.01)]
        along = [(0, 1, 0), (0, 1, 0), (1, 0, 0), (1, 0, 0)]
        return np.array(middles) + self.centre, np.array(along, float)


def extent_mm(mask: NDArray[np.bool_], axis: int) -> list[float]:
    """Return the first and last position of a mask along the picture's x (1) or y (0), from the middle [mm]."""
    places = np.flatnonzero(mask.any(axis=1 - axis))[[0, -1]]
    return ((places - CROP_PX / 2) / CROP_PX * 1000 * CROP).tolist()


def decision(
    view: LabelledCapture, found: ObservedCandidates, grasp: GraspCandidate | None = None, number: int = 0
) -> Decision:
    """Return an attempt with ``grasp``, or an abstention, decided on the frame ``view``."""
    outcome = {"abstention": Abstention.NO_CANDIDATE} if grasp is None else {"outcome": GraspOutcome.DELIVERED}
    result = PickResult(grasp=grasp, **outcome)  # type: ignore[arg-type]
    record = record_frame(0, view, found)
    return Decision(number=number, labelled_capture=view, observed=found, frame_record=record, result=result)


def near(picture: NDArray[np.uint8], colour: tuple[int, ...], by: int = 60) -> NDArray[np.bool_]:
    return np.asarray(np.abs(picture.astype(int) - np.array(colour)).max(axis=2) < by)


def test_the_jaw_is_drawn_where_it_was() -> None:
    # The grasp's y axis is the world's -y, which is down in the image; pads at 15 mm open to 25 mm from the centre.
    crop = Crop(frame(), np.array([0.5, 0.0, 0.0]), CROP)
    crop.jaw(grasp(width=0.03, opening=0.05))
    assert crop.picture.shape == (CROP_PX, CROP_PX, 3)
    orange = crop.picture[:, :, 2].astype(int) > crop.picture[:, :, 0].astype(int) + 60
    assert extent_mm(orange, 0) == pytest.approx([-25.0, 25.0], abs=1.5)
    assert extent_mm(orange, 1) == pytest.approx([-11.0, 11.0], abs=1.5)


@pytest.mark.parametrize(("error", "colour"), [(0.0, RIGHT), (0.02, WRONG)])
def test_the_chosen_pose_is_drawn_in_its_place_green_if_correct(error: float, colour: tuple[int, ...]) -> None:
    view = labelled_capture(np.array([1.0, 1.0]))
    moved = make_transform(translation=(error, 0.0, 0.0))
    found = ObservedCandidates(candidates=[candidate(view, 0, moved), candidate(view, 1)])
    picture = draw_decision(decision(view, found, grasp()), Corners())
    drawn = near(picture, colour)
    middle = 1000 * error * 0.9 / 0.89  # the upper face is 10 mm nearer to the camera
    face = 25 * 0.9 / 0.89
    assert extent_mm(drawn, 1) == pytest.approx([middle - face, middle + face], abs=1.5)
    assert not near(picture, RIGHT if error else WRONG).any()


def test_points_have_the_colour_of_the_part_that_their_segment_matches() -> None:
    # All 50 pixels of part 1 in one segment; the crop is around pixel 100 of the image's first row.
    ids = np.full(320, -1)
    ids[80:130] = 1
    view = labelled_capture(np.array([1.0, 1.0, 1.0]), ids)
    found = observed(view, [list(range(80, 130)), list(range(130, 200))], [candidate(view, 0)])
    looked_at = grasp()
    object.__setattr__(looked_at, "T_world_grasp", make_transform(np.diag([1.0, -1, -1]), (0.41, 0.18, 0.0)))
    picture = draw_decision(decision(view, found, looked_at), Corners())
    crop = Crop(frame(), np.array([0.41, 0.18, 0.0]), CROP)
    columns = np.flatnonzero(near(picture, tuple(part_colours(3)[1].tolist()), by=20).any(axis=0))
    first, last = (crop.scale * (u - 79.5 - 20) + CROP_PX / 2 for u in (79.5, 129.5))
    assert columns[[0, -1]] == pytest.approx([first, last], abs=3 * crop.scale)


def test_an_abstention_shows_the_whole_bin_with_all_candidates() -> None:
    view = labelled_capture(np.array([1.0, 1.0]))
    found = ObservedCandidates(
        candidates=[candidate(view, 0), candidate(view, 1, make_transform(translation=(0.0, 0.02, 0.0)))]
    )
    picture = draw_decision(decision(view, found), Corners())
    assert near(picture, RIGHT, 90).any()
    assert near(picture, WRONG, 90).any()
    both = near(picture, RIGHT, 90) | near(picture, WRONG, 90)
    left, right = (place / CROP * 0.4 for place in extent_mm(both, 1))  # 0.36 m of bin and a margin
    assert (left, right) == pytest.approx((-25 * 0.9 / 0.89, (70 + 25) * 0.9 / 0.89), abs=3)


def test_an_empty_bin_has_a_picture() -> None:
    view = labelled_capture(np.empty(0))
    found = observed(view, [], [])
    assert draw_decision(decision(view, found), Corners()).shape == (CROP_PX, CROP_PX, 3)


def test_an_album_writes_what_opencv_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "part_edges", lambda part: Corners())
    view = labelled_capture(np.array([1.0]))
    found = ObservedCandidates(candidates=[candidate(view, 0)])
    env: Any = None
    name = Album(tmp_path / "new", "bin_0007").after_decision(env, decision(view, found, grasp(), number=4))
    assert name == "bin_0007_pick_04.webp"
    picture = cv2.imread(str(tmp_path / "new" / name))
    assert picture is not None
    assert picture.shape == (CROP_PX, CROP_PX, 3)


def test_a_picture_that_cannot_be_encoded_raises(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "part_edges", lambda part: Corners())
    monkeypatch.setattr(pictures.cv2, "imencode", lambda *_: (False, None))
    view = labelled_capture(np.array([1.0]))
    env: Any = None
    with pytest.raises(RuntimeError, match=r"OpenCV could not encode bin_pick_00\.webp"):
        Album(tmp_path, "bin").after_decision(env, decision(view, ObservedCandidates()))
