"""Poses in the results format of the BOP challenge."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perception.geometry import make_transform, rotation_about, transform_points
from policies.frames import BopNames, FrameOutcome, save_bop_results
from policies.frames.bop import image_numbers

POSE = make_transform(rotation_about((0.3, 0.2, 0.9), 1.1), (0.01, -0.02, 0.8))
ORIGIN = (0.012, 0.034, -0.005)


def outcome(path: str, *poses: tuple[Any, bool]) -> FrameOutcome:
    values = {
        "part": {"name": "block", "d_max": 0.1, "origin_in_file": list(ORIGIN)},
        "ms": {"boundary": 20.0, "poses": 105.5},
        "poses": [{"T_cam_part": T.tolist(), "score": 0.9, "verified": verified} for T, verified in poses],
    }
    return FrameOutcome(path=Path(path), values=values, lines=())


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_row_maps_the_models_file_to_the_camera_in_millimetres(tmp_path: Path) -> None:
    save_bop_results(tmp_path / "a.csv", [outcome("7.png", (POSE, True), (POSE, False))], BopNames(obj_id=5))
    assert (tmp_path / "a.csv").read_text().splitlines()[0] == "scene_id,im_id,obj_id,score,R,t,time"
    (row,) = rows_of(tmp_path / "a.csv")
    assert (row["scene_id"], row["im_id"], row["obj_id"], row["score"]) == ("1", "7", "5", "0.900000")
    assert float(row["time"]) == pytest.approx(0.1255)
    R = np.array(row["R"].split(), float).reshape(3, 3)
    t_mm = np.array(row["t"].split(), float)
    points_part = np.random.default_rng(0).normal(scale=0.03, size=(5, 3))
    points_file = points_part + ORIGIN
    np.testing.assert_allclose(
        1000 * points_file @ R.T + t_mm, 1000 * transform_points(POSE, points_part), rtol=0, atol=1e-5
    )


def test_frames_without_poses_have_no_row_and_keep_their_number(tmp_path: Path) -> None:
    unread = replace(outcome("b.png"), values=None)
    save_bop_results(tmp_path / "a.csv", [outcome("a.png"), unread, outcome("c.png", (POSE, True))])
    (row,) = rows_of(tmp_path / "a.csv")
    assert row["im_id"] == "2"


def test_bops_layout_and_numeric_names_give_the_numbers() -> None:
    paths = [Path("test/000048/depth/000001.png"), Path("test/000049/depth/000001.png")]
    assert image_numbers(paths) == [(48, 1), (49, 1)]
    assert image_numbers(paths[:1], 3) == [(3, 1)]
    assert image_numbers([Path("12/rgb/1.png")]) == [(1, 1)]  # BOP's depth images lie in SCENE/depth
    assert image_numbers([Path("3.png"), Path("left.png")]) == [(1, 0), (1, 1)]


def test_images_of_the_same_number_are_refused() -> None:
    with pytest.raises(ValueError, match=r"a/1\.png and b/01\.png would both be image 1 of scene 1: write"):
        image_numbers([Path("a/1.png"), Path("b/01.png")])


@pytest.mark.parametrize("name", ["obj_id", "scene_id"])
def test_negative_numbers_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} must not be negative, got -1"):
        BopNames(**{name: -1})
