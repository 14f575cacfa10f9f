from pathlib import Path

import cv2
import numpy as np
import pytest

from policies.commands.picture import Arguments
from tests.policies.commands.command_calls import run


def test_every_option_of_the_cell_arrives_in_the_scenes() -> None:
    args = Arguments(show="poses", sensor="harsh", camera_distance=1.1, friction=0.2, jaw=0.05, hand_eye_mm=2.0)
    scenes = args.scenes()
    assert (scenes.sensor, scenes.camera.distance, scenes.friction) == ("harsh", 1.1, 0.2)
    assert (scenes.camera.width, scenes.camera.height) == (1280, 960)
    assert (args.options().cell().robot.jaw, args.options().cell().camera.hand_eye) == (0.05, 0.002)
    assert Arguments().size() == (1200, 800)
    assert Arguments(width=150, height=100).size() == (150, 100)


@pytest.mark.slow
def test_picture_makes_a_picture(tmp_path: Path) -> None:
    done = run("picture", "--width", "150", "--height", "100", "--out", str(tmp_path / "new" / "cell.png"))
    assert done.returncode == 0, done.stderr
    picture = cv2.imread(str(tmp_path / "new" / "cell.png"))
    assert picture is not None
    assert picture.shape == (100, 150, 3)
    assert picture.std() > 20
    assert run("picture", "--part", "teapot").returncode == 2


@pytest.mark.slow
def test_picture_makes_one_of_a_segmented_frame(tmp_path: Path) -> None:
    out = tmp_path / "segmentation.png"
    done = run("picture", "--show", "segmentation", "--part", "bracket", "--out", str(out))
    assert done.returncode == 0, done.stderr
    picture = cv2.imread(str(out))
    assert picture is not None
    third = picture.shape[1] // 3
    image, truth, prediction = (picture[:, k * third : (k + 1) * third].astype(float) for k in range(3))
    assert np.ptp(image, axis=2).max() == 0
    drawn = np.ptp(truth, axis=2) > 60  # coloured
    assert np.mean(np.abs(truth - prediction).max(axis=2)[drawn] == 0) > 0.7  # most points have their part's colour
