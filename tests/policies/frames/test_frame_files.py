"""What is a frame in a folder."""

import json
from pathlib import Path

import pytest

from perception.capture import write_frame
from policies.frames import frames_in
from tests.perception.block_scene import photographed


def names(paths: tuple[Path, ...]) -> list[str]:
    return [path.name for path in paths]


def test_frames_are_told_from_what_belongs_to_them(tmp_path: Path) -> None:
    write_frame(photographed(), tmp_path / "whole.json", scale=0.0001)
    for name in ("b.png", "b_grey.png", "a.pcd", "notes.txt", "c.npz", "d.mcap"):
        (tmp_path / name).touch()
    (tmp_path / "camera.json").write_text(json.dumps({"fx": 600, "fy": 600, "cx": 320, "cy": 240}))
    (tmp_path / "broken.json").write_text('{"depth": ')
    (tmp_path / "calibration.npz").touch()
    found = frames_in(tmp_path, grey=str(tmp_path / "{stem}_grey.png"), calibration=tmp_path / "calibration.npz")
    assert names(found) == ["a.pcd", "b.png", "broken.json", "c.npz", "d.mcap", "whole.json"]


def test_without_a_pattern_other_images_are_frames_too(tmp_path: Path) -> None:
    for name in ("b.png", "b_grey.png"):
        (tmp_path / name).touch()
    assert names(frames_in(tmp_path)) == ["b.png", "b_grey.png"]


def test_a_folder_without_frames_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").touch()
    with pytest.raises(ValueError, match=r"must hold frames .* got none"):
        frames_in(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"there is no folder .*lost: give one by --frames"):
        frames_in(tmp_path / "lost")
