"""Crops and quarter turns move pixels, not points of the world."""

import numpy as np
import pytest

from perception.capture import crop_frame, turn_frame
from perception.frame import Frame
from perception.geometry import deproject_depth, make_transform, rotation_about, transform_points
from tests.perception.capture.camera_files import HEIGHT, WIDTH, K, scene_depth

POSE = make_transform(rotation_about((1, 2, 3), 0.8), (0.1, 0.2, 1.0))


@pytest.fixture
def frame() -> Frame:
    grey = np.arange(WIDTH * HEIGHT, dtype=np.uint8).reshape(HEIGHT, WIDTH)
    return Frame(grey=grey, depth=scene_depth(), K=K, T_world_cam=POSE)


def world_points(frame: Frame) -> dict[int, list[float]]:
    """Return the world point of each measured pixel by its grey value."""
    points = transform_points(frame.T_world_cam, deproject_depth(frame.K, frame.depth).reshape(-1, 3))
    known = frame.valid.ravel()
    return dict(zip(frame.grey.ravel()[known].tolist(), points[known].tolist(), strict=True))


@pytest.mark.parametrize("turns", [0, 1, 2, 3, 4, -1])
def test_a_turned_frame_shows_the_same_points(frame: Frame, turns: int) -> None:
    turned = turn_frame(frame, turns)
    np.testing.assert_array_equal(turned.grey, np.rot90(frame.grey, turns))
    before, after = world_points(frame), world_points(turned)
    assert before.keys() == after.keys()
    for value in before:
        np.testing.assert_allclose(after[value], before[value], atol=1e-12)
    assert np.linalg.det(turned.T_world_cam[:3, :3]) == pytest.approx(1)


def test_a_cropped_frame_shows_the_same_points(frame: Frame) -> None:
    part = crop_frame(frame, 2, 1, 4, 3)
    np.testing.assert_array_equal(part.grey, frame.grey[1:4, 2:6])
    before, after = world_points(frame), world_points(part)
    assert len(after) == 12
    for value in after:
        np.testing.assert_allclose(after[value], before[value], atol=1e-12)


@pytest.mark.parametrize("crop", [(-1, 0, 2, 2), (0, 0, 9, 2), (0, 5, 2, 2), (0, 0, 0, 2)])
def test_a_crop_beside_the_image_is_refused(frame: Frame, crop: tuple[int, int, int, int]) -> None:
    with pytest.raises(ValueError, match="must lie in the image of 8 x 6 pixels, got"):
        crop_frame(frame, *crop)


def test_a_crop_may_be_far_from_the_optical_axis(frame: Frame) -> None:
    assert crop_frame(frame, 0, 0, 1, 1).K[:2, 2].tolist() == frame.K[:2, 2].tolist()


@pytest.mark.parametrize("crop", [(0.5, 0, 2, 2), (0, 0, 2.25, 2)])
def test_a_crop_of_broken_pixels_is_refused(frame: Frame, crop: tuple[float, float, float, float]) -> None:
    with pytest.raises(ValueError, match="must be of whole pixels, got"):
        crop_frame(frame, *crop)  # type: ignore[arg-type]
    whole = crop_frame(frame, *(float(value) for value in (1, 1, 2, 2)))  # type: ignore[arg-type]
    np.testing.assert_array_equal(whole.grey, frame.grey[1:3, 1:3])
