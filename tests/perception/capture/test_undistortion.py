"""Points of a distorted image end up where OpenCV's undistortion of points puts them; no depth is interpolated."""

import cv2
import numpy as np
import pytest

from perception.capture import Calibration
from perception.capture.undistortion import undistort

K = np.array([[60.0, 0, 31.2], [0, 61.0, 23.6], [0, 0, 1]])
MODELS = {
    "plumb_bob": [-0.2, 0.05, 0.002, -0.003, 0.01],
    "rational_polynomial": [-0.3, 0.1, 0.001, 0.002, 0, 0.1, 0, 0],
}


@pytest.mark.parametrize("model", MODELS)
def test_a_spot_moves_to_where_opencv_undistorts_it(model: str) -> None:
    calibration = Calibration(K=K, distortion=np.array(MODELS[model]))
    shifts = []
    for u, v in [(10, 8), (50, 10), (31, 24), (52, 40)]:
        depth, grey = np.full((48, 64), 0.9, np.float32), np.zeros((48, 64), np.uint8)
        depth[v - 1 : v + 2, u - 1 : u + 2] = 0.7
        grey[v - 1 : v + 2, u - 1 : u + 2] = 255
        straight_grey, straight = undistort(grey, depth, calibration)
        ((wanted,),) = cv2.undistortPoints(np.array([[[u, v]]], np.float64), K, calibration.distortion, P=K)
        shifts.append(np.linalg.norm(wanted - (u, v)))
        found = np.argwhere(straight == np.float32(0.7))[:, ::-1].mean(axis=0)
        assert np.abs(found - wanted).max() < 0.6  # whole pixels
        assert straight_grey is not None
        weights = straight_grey.astype(float)
        found = np.array([(weights.sum(axis=1 - axis) @ np.arange(weights.shape[axis])) for axis in (1, 0)])
        assert np.abs(found / weights.sum() - wanted).max() < 0.15
    assert max(shifts) > 1


def test_depths_are_never_interpolated_and_outside_is_missing() -> None:
    depth = np.where(np.arange(64) < 30, 0.7, 0.9).astype(np.float32) * np.ones((48, 1), np.float32)
    calibration = Calibration(K=K, distortion=np.array([0.3, 0.1, 0, 0, 0]))  # pincushion: the corners saw nothing
    grey, straight = undistort(np.full((48, 64), 80, np.uint8), depth, calibration)
    assert set(np.unique(straight)) == {np.float32(0), np.float32(0.7), np.float32(0.9)}
    assert grey is not None
    assert (grey == 80).all()


def test_without_distortion_nothing_changes() -> None:
    depth, grey = np.ones((4, 5), np.float32), np.ones((4, 5), np.uint8)
    same_grey, same = undistort(grey, depth, Calibration(K=K, distortion=np.zeros(5)))
    assert same is depth
    assert same_grey is grey
    assert undistort(None, np.ones((48, 64), np.float32), Calibration(K=K, distortion=np.array([0.1] * 4)))[0] is None
