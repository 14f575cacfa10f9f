"""Calibrations are checked at the door; scaled and cropped ones project points where the new image shows them."""

import re
from typing import Any

import numpy as np
import pytest

from perception.capture import Calibration
from perception.capture.calibration import pose_from_world_to_camera, require_pose
from perception.geometry import invert_transform, make_transform, project_points, rotation_about

K = [[500.0, 0, 310.0], [0, 505.0, 245.0], [0, 0, 1]]
POINTS_CAM = np.array([[0.1, 0.2, 0.9], [-0.2, 0.1, 0.7]])


@pytest.mark.parametrize("kind", [list, tuple, np.float32])
def test_nested_sequences_and_single_precision_become_float64(kind: Any) -> None:
    given_K = np.array(K, np.float32) if kind is np.float32 else kind(kind(row) for row in K)
    pose = np.eye(4, dtype=np.float32) if kind is np.float32 else kind(kind(row) for row in np.eye(4).tolist())
    calibration = Calibration(K=given_K, distortion=[0.1, 0, 0, 0], size=[640, 480], T_world_cam=pose)  # type: ignore[arg-type]
    assert calibration.K.dtype == np.float64
    assert calibration.size == (640, 480)
    assert calibration.T_world_cam is not None
    assert calibration.T_world_cam.dtype == np.float64
    np.testing.assert_array_equal(calibration.K, K)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"K": np.eye(4)}, r"K must be \(3, 3\), got \(4, 4\)"),
        ({"K": np.diag([-5.0, 5, 1])}, "K must be finite with positive focal lengths"),
        ({"K": [[5, 0.1, 2], [0, 5, 2], [0, 0, 1]]}, r"K must have no skew, got K\[0, 1\] = 0.1 px: calibrate without"),
        ({"K": np.array(K).T}, "is it transposed"),
        ({"distortion": [0.1]}, r"distortion must be 0, 4, 5, 8, 12, 14 finite coefficients .* got \[0.1\]"),
        ({"distortion": [np.nan] * 5}, "finite coefficients"),
        ({"size": (640, 0)}, r"size must be a positive width and height \[px\], got \(640, 0\)"),
        ({"depth_scale": "mm"}, r"depth_scale must be a positive length \[m\] per unit, got mm"),
        ({"depth_scale": True}, r"depth_scale must be a positive length \[m\] per unit, got True"),
        ({"K": "camera.json"}, "K must be an array of numbers, got 'camera.json'"),
        ({"depth_scale": 0.0}, r"depth_scale must be a positive length \[m\] per unit, got 0.0"),
        ({"T_world_cam": np.eye(3)}, r"T_world_cam must be \(4, 4\), got \(3, 3\)"),
        ({"T_world_cam": np.diag([2.0, 1, 1, 1])}, "T_world_cam must be rigid"),
        ({"T_world_cam": np.diag([1.0, 1, -1, 1])}, "T_world_cam must be right-handed"),
    ],
)
def test_nonsense_is_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Calibration(**({"K": K} | changes))


def test_a_scaled_calibration_projects_to_the_scaled_image() -> None:
    calibration = Calibration(K=np.array(K), size=(640, 480))
    half = calibration.scaled((320, 240))
    before, after = (project_points(each.K, POINTS_CAM) for each in (calibration, half))
    np.testing.assert_allclose(after + 0.5, (before + 0.5) / 2)  # the image begins half a pixel before its first centre
    assert half.size == (320, 240)


def test_a_cropped_calibration_projects_to_the_cropped_image() -> None:
    calibration = Calibration(K=np.array(K), size=(640, 480))
    part = calibration.cropped(100, 50, 200, 150)
    np.testing.assert_allclose(
        project_points(part.K, POINTS_CAM), project_points(calibration.K, POINTS_CAM) - (100, 50)
    )
    assert part.size == (200, 150)
    assert Calibration(K=np.array(K)).cropped(1, 2, 3, 4).size == (3, 4)


def test_scales_and_crops_that_cannot_be_are_refused() -> None:
    calibration = Calibration(K=np.array(K), size=(640, 480))
    with pytest.raises(ValueError, match="a calibration without an image size cannot be scaled"):
        Calibration(K=np.array(K)).scaled((320, 240))
    with pytest.raises(ValueError, match="640 x 480 pixels cannot be scaled to 640 x 360: the ratio of its sides"):
        calibration.scaled((640, 360))
    text = "a crop (u0, v0, width, height) must lie in the image of 640 x 480 pixels, got (600, 0, 41, 10)"
    with pytest.raises(ValueError, match=re.escape(text)):
        calibration.cropped(600, 0, 41, 10)
    with pytest.raises(ValueError, match="the image must have the calibrated size 640 x 480, got 320 x 240"):
        calibration.require_size((320, 240))


def test_the_worlds_pose_in_the_camera_is_turned_round() -> None:
    T_cam_world = make_transform(rotation_about((1, 2, 3), 0.7), (0.1, 0.2, 0.9))
    pose = pose_from_world_to_camera(T_cam_world[:3, :3].ravel().tolist(), T_cam_world[:3, 3].tolist())
    np.testing.assert_allclose(pose, invert_transform(T_cam_world), atol=1e-15)
    with pytest.raises(ValueError, match="the pose of the world in the camera must be rigid"):
        pose_from_world_to_camera(np.zeros((3, 3)), np.zeros(3))
    np.testing.assert_array_equal(require_pose("T", np.eye(4, dtype=np.float32)), np.eye(4))
