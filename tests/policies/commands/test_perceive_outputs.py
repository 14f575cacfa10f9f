"""Grasps, recordings of `binpick perceive` for a viewer, and frames in recordings of a camera."""

import importlib.util
import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import binpick_env.parts
from perception.capture import write_frame
from perception.frame import Frame
from perception.geometry import make_transform
from policies.frames import FrameRecord, grasp_finder
from policies.report import frame_recording
from tests.perception.capture.bags import Entry, Messages
from tests.policies.commands.command_calls import run
from tests.policies.commands.perceive_calls import EMPTY, FRAME, IN_BIN, POSE, frames_in
from tests.policies.frames.test_grasp_finder import few_grasps
from tests.rerun_rows import rows_of


def test_grasps_are_printed_and_written(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grasp_finder, "sample_grasps", few_grasps)
    done = run("perceive", "full.npz", *IN_BIN, "--grasps", "--json", "full.json", cwd=folder)
    assert done.returncode == 0, done.stderr
    (frame,) = frames_in(folder / "full.json")
    assert len(frame["grasps"]) >= 1
    best = frame["grasps"][0]
    assert best["reachable"] is None
    assert frame["poses"][best["pose"]]["verified"]
    lines = done.stdout.splitlines()
    (start,) = (k for k, line in enumerate(lines) if line.startswith("grasps clear of everything else on "))
    assert lines[start].endswith(" of 2 parts")
    rows = [line.split() for line in lines[start + 2 :] if line.endswith("unknown")]
    assert len(rows) == len({grasp["pose"] for grasp in frame["grasps"]})
    (row,) = (row for row in rows if int(row[0]) == best["pose"] + 1)
    assert float(row[2]) == pytest.approx(1000 * best["width"], abs=0.05)
    assert float(row[4]) == pytest.approx(1000 * best["T_world_grasp"][0][3], abs=0.05)


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ([*IN_BIN, "--jaw", "0.05"], "--jaw and --robot-base are about grasps: give --grasps, too"),
        (["--part", "ell.stl", "--no-bin", "--grasps", "--robot-base", *POSE], "the reach of a robot needs a bin"),
        (
            [*IN_BIN, "--grasps", "--robot-base", "lost.json"],
            "16 numbers row by row (--robot-base on the command line)",
        ),
    ],
)
def test_options_of_grasps_without_a_meaning_are_refused_before_the_part_is_loaded(
    options: list[str], error: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(binpick_env.parts, "load_part", lambda *_, **__: pytest.fail("loaded"), raising=False)
    done = run("perceive", "full.npz", *options, cwd=folder)
    assert done.returncode == 2
    assert error in done.stderr


@pytest.mark.slow
def test_a_recording_holds_all_frames_and_nothing_is_resumed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grasp_finder, "sample_grasps", few_grasps)
    call = ["full.npz", "empty.json", *IN_BIN, "--out", "found", "--grasps"]
    assert run("perceive", *call, cwd=folder).returncode == 0
    done = run("perceive", *call, "--rerun", "new/seen.rrd", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "already there" not in done.stdout
    assert "recording new/seen.rrd" in done.stdout
    rows = rows_of(folder / "new" / "seen.rrd")
    for entity in ("seen/cloud", "seen/segments", "seen/scores", "bin", "grasps"):
        assert rows[f"/world/{entity}"] == 2, entity
    assert rows["/world/seen/poses"] == 3  # the shape, and the poses in each frame
    assert rows["/report"] == 2
    assert [path.name for path in (folder / "new").iterdir()] == ["seen.rrd"]


def test_pictures_of_a_frame_without_a_grey_image_show_its_depth(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_frame(Frame(depth=FRAME.depth, K=FRAME.K, T_world_cam=FRAME.T_world_cam), folder / "blind.npz")
    shown: list[Frame] = []
    monkeypatch.setattr(frame_recording, "log_camera", lambda _, frame: shown.append(frame))
    call = ["blind.npz", *IN_BIN, "--rerun", "seen.rrd", "--overlay", "seen", "--json", "blind.json"]
    done = run("perceive", *call, cwd=folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0].endswith("100.0 % with depth, no grey image")
    (frame,) = frames_in(folder / "blind.json")
    assert (frame["reading"]["grey"], frame["report"]["boundary_source"]) == ("none", "depth")
    assert np.median(shown[0].grey) > 100
    assert np.median(cv2.imread(str(folder / "seen" / "blind_poses.png"))) > 75


def test_a_stopped_run_leaves_no_recording(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(frame_recording, "frame_cloud", stop)
    assert run("perceive", "full.npz", *IN_BIN, "--rerun", "new/seen.rrd", cwd=folder).returncode == 130
    assert list((folder / "new").iterdir()) == []


def test_a_recordings_name_is_checked_before_anything_is_perceived(folder: Path) -> None:
    done = run("perceive", "full.npz", *IN_BIN, "--rerun", "seen.mp4", cwd=folder)
    assert done.returncode == 2
    assert "a recording's name must end in .rrd, got 'seen.mp4'" in done.stderr


def test_a_missing_extra_is_an_error_that_names_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    (folder / "cell.bag").touch()
    done = run("perceive", "cell.bag", *IN_BIN, cwd=folder)
    assert done.returncode == 1
    assert 'error: cell.bag: cell.bag needs rosbags, which reads ROS bags and MCAP: pip install "binp' in done.stderr
    monkeypatch.setitem(sys.modules, "rerun", None)
    done = run("perceive", "full.npz", *IN_BIN, "--rerun", "seen.rrd", cwd=folder)
    assert done.returncode == 2
    assert "error: a recording needs Rerun: " in done.stderr


@pytest.mark.slow
def test_recordings_are_perceived_one_by_one_or_in_a_folder(folder: Path) -> None:
    make = Messages("mcap")
    height, width = FRAME.depth.shape
    entries: list[Entry] = [("/d/camera_info", 0, make.info((width, height), camera=FRAME.K))]
    for k, frame in enumerate((EMPTY, FRAME)):
        entries.append(("/d/image", 10 * k + 1, make.image(frame.depth, "32FC1")))
        entries.append(("/g/image", 10 * k + 2, make.image(frame.grey, "mono8")))
    (folder / "frames").mkdir()
    make.write(folder / "frames" / "cell", entries)
    done = run("perceive", "frames/cell", *IN_BIN, "--index", "-1", "--json", "one.json", cwd=folder)
    assert done.returncode == 0, done.stderr
    (frame,) = frames_in(folder / "one.json")
    assert sum(pose["verified"] for pose in frame["poses"]) == 2
    assert (frame["reading"]["grey"], frame["K"]) == ("image", FRAME.K.tolist())
    call = ["--frames", "frames", *IN_BIN, "--index", "-1", "--out", "found"]
    assert run("perceive", *call, cwd=folder).returncode == 0
    config = json.loads((folder / "found" / "config.json").read_text())
    assert config.pop("index") == -1
    (folder / "found" / "config.json").write_text(json.dumps(config))
    other = run("perceive", *call, cwd=folder)
    assert "holds poses of another configuration (index: 0 there, -1 here)" in other.stderr


def test_a_recording_has_the_camera_where_the_bin_corrected_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    corrected = make_transform(translation=(0.1, 0.0, 0.0))
    monkeypatch.setattr(FrameRecord, "T_world_cam", property(lambda _: corrected))
    cameras: list[Frame] = []
    monkeypatch.setattr(frame_recording, "log_camera", lambda _, frame: cameras.append(frame))
    assert run("perceive", "full.npz", *IN_BIN, "--rerun", "seen.rrd", cwd=folder).returncode == 0
    (camera,) = cameras
    np.testing.assert_array_equal(camera.T_world_cam, corrected)
