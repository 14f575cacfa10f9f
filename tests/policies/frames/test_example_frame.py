"""The frame that ships with the package."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from perception.capture import read_frame
from policies.commands import example
from policies.frames import copy_example, example_files
from policies.frames.example_frame import SOURCE

MOST_BYTES = 300_000


def test_the_example_is_small_and_says_where_it_comes_from() -> None:
    assert set(example_files()) == {"README.md", "camera.json", "cell.json", "depth.png", "grey.png", "part.stl"}
    assert sum((SOURCE / name).stat().st_size for name in example_files()) < MOST_BYTES
    assert "It is simulated" in (SOURCE / "README.md").read_text()


def test_a_copy_is_a_frame_over_a_bin(tmp_path: Path) -> None:
    folder = copy_example(tmp_path / "demo")
    frame = read_frame(folder / "depth.png", grey=folder / "grey.png", calibration=folder / "camera.json")
    assert 0.7 < np.median(frame.depth[frame.valid]) < 1.0
    assert 0.5 < frame.valid.mean() < 1
    part = trimesh.load(folder / "part.stl")
    assert part.is_watertight
    assert 20 < part.extents.max() < 200  # millimetres


def test_files_that_are_there_are_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert example.main([str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines() == [str(tmp_path / name) for name in example_files()]
    (tmp_path / "depth.png").write_text("mine")
    assert example.main([str(tmp_path)]) == 2
    assert "must not hold README.md, camera.json" in capsys.readouterr().err
    assert (tmp_path / "depth.png").read_text() == "mine"
