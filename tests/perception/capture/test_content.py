"""An NPZ file states what a calibration in JSON does, under the same names."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perception.capture import Calibration, read_frame, read_frame_with_report
from perception.capture.content import load_content
from tests.perception.capture.camera_files import HEIGHT, WIDTH, K, scene_depth, scene_points

D = [0.1, 0.02, 0, 0, 0]
POSE = np.array([[1.0, 0, 0, 0.1], [0, -1, 0, 0.2], [0, 0, -1, 0.9], [0, 0, 0, 1]])
COLOURS = np.full((HEIGHT, WIDTH, 3), (255, 0, 0), np.uint8)  # red, whose grey is 76
STORED = np.rint(scene_depth() * 10000).astype(np.uint16)


def saved(folder: Path, **arrays: Any) -> Path:
    np.savez(folder / "a.npz", **arrays)
    return folder / "a.npz"


def test_integers_are_in_the_unit_that_is_stated(tmp_path: Path) -> None:
    for unit in ({"depth_scale": 0.1}, {"depth_units": [0.0001]}, {"depth_scale": "0.1 mm"}):
        frame = read_frame(saved(tmp_path, depth=STORED, K=K, **unit))
        np.testing.assert_allclose(frame.depth, scene_depth(), atol=6e-5)
        given = read_frame(saved(tmp_path, depth=STORED, T_world_cam=POSE, **unit), calibration=K)
        np.testing.assert_allclose(given.depth, scene_depth(), atol=6e-5)
        np.testing.assert_array_equal(given.T_world_cam, POSE)


@pytest.mark.parametrize("name", ["distortion", "distCoeffs", "dist", "D"])
def test_the_lens_is_that_of_any_name(tmp_path: Path, name: str) -> None:
    content = load_content(saved(tmp_path, depth=scene_depth(), camera_matrix=K, **{name: [D]}))
    assert content.calibration is not None
    np.testing.assert_array_equal(content.calibration.distortion, D)


def test_colours_are_those_of_the_points(tmp_path: Path) -> None:
    organised = read_frame(saved(tmp_path, points=scene_points(), colors=COLOURS))
    assert (organised.grey == 76).all()
    path = saved(tmp_path, points=scene_points().reshape(-1, 3), colors=COLOURS.reshape(-1, 3))
    frame, report = read_frame_with_report(path, calibration=Calibration(K=K, size=(WIDTH, HEIGHT)))
    assert report.grey == "cloud"
    assert (frame.grey[frame.valid] == 76).all()


@pytest.mark.parametrize(
    ("arrays", "text"),
    [
        ({"K": np.eye(4)}, "a.npz must hold a camera matrix as one of RealSense"),
        ({"K": K, "fisheye_D": [0.1, 0, 0, 0]}, "a.npz states 'fisheye_D', which is about the lens"),
        ({"K": K, "colors": COLOURS / 255}, "the image colors in a.npz must be uint8 or uint16, got float64"),
        ({"depth_scale": -1.0}, "depth_scale must be positive and finite, got -1.0"),
        ({"T_world_cam": np.diag([2.0, 1, 1, 1])}, "T_world_cam must be rigid"),
    ],
)
def test_what_is_not_understood_is_refused(tmp_path: Path, arrays: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        load_content(saved(tmp_path, depth=STORED, **arrays))
