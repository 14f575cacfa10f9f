"""`binpick perceive` on ray-cast frames of two blocks, with a segmentation that knows the groups."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from perception.capture import write_frame
from perception.geometry import deproject_depth, make_transform
from perception.metrics.pose_errors import pose_error
from perception.segmentation.predictor import SegmentationPredictor
from tests.perception.block_scene import BIN, ELL, POSES
from tests.policies.commands.command_calls import run
from tests.policies.commands.perceive_calls import EMPTY, ESTIMATOR, FRAME, IN_BIN, POSE, frames_in


def test_poses_are_printed_and_written(folder: Path) -> None:
    done = run("perceive", "full.npz", *IN_BIN, "--json", "full.json", "--overlay", "seen", cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    (frame,) = frames_in(folder / "full.json")
    assert [pose["verified"] for pose in frame["poses"]] == [True, True]
    scores = [pose["score"] for pose in frame["poses"]]
    assert scores == sorted(scores, reverse=True)
    for pose in frame["poses"]:
        assert 0 < pose["expected_error"]["rotation"] < 0.2
        assert 0 < pose["expected_error"]["translation"] < 0.002
        errors = [pose_error(np.array(pose["T_cam_part"]), T, ELL).translation for T in POSES]
        assert min(errors) < 0.001
        assert pose["T_world_part"] == pose["T_cam_part"]  # the camera's frame is the world
    assert (frame["frame"], frame["part"]["name"], frame["weights"]["training"]) == ("full.npz", "ell", "zero-shot")
    assert frame["K"] == FRAME.K.tolist()
    np.testing.assert_allclose(frame["bin"]["T_world_bin"], BIN.T_world_bin, atol=1e-3)  # it is measured
    assert frame["bin"]["inner_size"] == pytest.approx(BIN.inner_size)
    assert frame["report"]["poses"]["found"] == 2
    lines = done.stdout.splitlines()
    assert lines[0].startswith("full.npz: depth image, 240 x 180 px, 100.0 % with depth, grey from image")
    assert any(line.startswith("poses: 2 of 2 groups") for line in lines)
    rows = [line.split() for line in lines if line.endswith("  yes")]
    assert [row[0] for row in rows] == ["1", "2"]
    assert [float(row[1]) for row in rows] == pytest.approx(scores, abs=0.0005)
    assert float(rows[0][5]) == pytest.approx(1000 * frame["poses"][0]["T_cam_part"][0][3], abs=0.05)


def test_the_outlines_lie_on_the_parts(folder: Path) -> None:
    assert run("perceive", "full.npz", *IN_BIN, "--overlay", "seen", cwd=folder).returncode == 0
    picture = cv2.imread(str(folder / "seen" / "full_poses.png"))
    assert picture is not None
    assert picture.shape == (180, 240, 3)
    drawn = np.ptp(picture.astype(int), axis=2) > 60
    part = FRAME.grey != 60
    near = cv2.dilate(part.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert np.count_nonzero(drawn) > 200
    assert np.mean(near[drawn]) > 0.98


def test_the_cameras_pose_moves_the_poses_into_the_world(folder: Path) -> None:
    T_world_cam = np.diag([1.0, -1.0, -1.0, 1.0])
    T_world_cam[:3, 3] = 0.1, 0.2, 0.9
    (folder / "cell.json").write_text(
        json.dumps({"T_world_cam": T_world_cam.tolist(), "T_world_bin": (T_world_cam @ BIN.T_world_bin).tolist()})
    )
    options = ["--part", "ell.stl", "--bin", "400x300x100", "--bin-pose", "cell.json", "--camera-pose", "cell.json"]
    assert run("perceive", "full.npz", *options, "--json", "full.json", cwd=folder).returncode == 0
    (frame,) = frames_in(folder / "full.json")
    assert frame["T_world_cam"] == T_world_cam.tolist()
    assert len(frame["poses"]) == 2
    for pose in frame["poses"]:
        np.testing.assert_allclose(pose["T_world_part"], T_world_cam @ np.array(pose["T_cam_part"]), atol=1e-12)


def test_without_a_bin_everything_is_searched(folder: Path) -> None:
    options = ["--part", "ell.stl", "--no-bin", "--json", "full.json"]
    done = run("perceive", "full.npz", "empty.json", *options, cwd=folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("no bin limits the poses") == 2
    full, empty = frames_in(folder / "full.json")
    assert full["bin"] is None
    assert sum(pose["verified"] for pose in full["poses"]) == 2
    assert empty["poses"] == []
    assert ESTIMATOR.workspace is None


def test_only_what_lies_in_the_bin_is_searched(folder: Path) -> None:
    beside = [*POSE]
    beside[3] = "0.2"  # the bin begins between the blocks
    options = ["--part", "ell.stl", "--bin", "400x300x100", "--bin-pose", *beside]
    assert run("perceive", "full.npz", *options, "--json", "half.json", cwd=folder).returncode == 0
    assert run("perceive", "full.npz", *IN_BIN, "--json", "full.json", cwd=folder).returncode == 0
    (half,), (full,) = frames_in(folder / "half.json"), frames_in(folder / "full.json")
    assert 0 < half["report"]["boundary_points"] < 0.7 * full["report"]["boundary_points"]
    assert sum(pose["verified"] for pose in half["poses"]) <= 1


def test_an_empty_bin_is_no_error_and_has_a_reason(folder: Path) -> None:
    done = run("perceive", "empty.json", *IN_BIN, cwd=folder)
    assert done.returncode == 0
    assert "no part was found: there are no boundary points, as in an empty bin" in done.stdout


def test_a_frame_without_parts_for_a_reason_is_no_error(folder: Path) -> None:
    dark = replace(FRAME, depth=np.zeros_like(FRAME.depth))
    write_frame(dark, folder / "dark.npz")
    for options in (IN_BIN, ["--part", "ell.stl", "--no-bin"]):
        done = run("perceive", "dark.npz", *options, cwd=folder)
        assert done.returncode == 0
        assert "likely cause: no pixel has a depth" in done.stdout
        assert "no part was found: there are no boundary points; the likely causes stand above" in done.stdout


def test_a_bad_file_is_told_and_does_not_stop_the_others(folder: Path) -> None:
    (folder / "bad.npz").write_bytes(b"PK\x03\x04 nothing")
    done = run("perceive", "bad.npz", "lost.npz", "full.npz", *IN_BIN, "--json", "all.json", cwd=folder)
    assert done.returncode == 1
    assert "error: bad.npz: " in done.stderr
    assert "error: lost.npz: " in done.stderr
    assert [frame["frame"] for frame in frames_in(folder / "all.json")] == ["full.npz"]
    unread = json.loads((folder / "all.json").read_text())["unread"]
    assert [each["frame"] for each in unread] == ["bad.npz", "lost.npz"]
    assert all(each["error"] for each in unread)


def test_a_folder_of_results_is_resumed_but_not_mixed(folder: Path) -> None:
    call = ["full.npz", "empty.json", *IN_BIN, "--out", "found"]
    assert run("perceive", *call, cwd=folder).returncode == 0
    names = {f"{stem}_poses{suffix}" for stem in ("full", "empty") for suffix in (".json", ".png")}
    assert {path.name for path in (folder / "found").iterdir()} == {*names, "config.json"}
    first = (folder / "found" / "full_poses.json").read_bytes()
    (folder / "found" / "empty_poses.json").write_text("{")
    again = run("perceive", *call, "--json", "all.json", cwd=folder)
    assert again.returncode == 0
    assert "full.npz: already there, 2 verified poses in found/full_poses.json" in again.stdout
    assert "empty.json: already there" not in again.stdout  # its file was damaged
    assert (folder / "found" / "full_poses.json").read_bytes() == first
    assert [len(frame["poses"]) for frame in frames_in(folder / "all.json")] == [2, 0]
    other = run("perceive", "full.npz", *IN_BIN, "--depth-scale", "0.5", "--out", "found", cwd=folder)
    assert other.returncode == 2
    assert "holds poses of another configuration (scale: None there, 0.5 here)" in other.stderr


@pytest.mark.slow
def test_results_of_other_contents_are_not_taken(folder: Path) -> None:
    write_frame(FRAME, folder / "cell.json")
    call = ["cell.json", *IN_BIN, "--out", "found"]
    assert run("perceive", *call, cwd=folder).returncode == 0
    write_frame(EMPTY, folder / "new" / "cell.json")
    (folder / "cell_depth.png").write_bytes((folder / "new" / "cell_depth.png").read_bytes())
    again = run("perceive", *call, "--json", "all.json", cwd=folder)
    assert "cell.json: perceived again, since image cell_depth.png changed since its results were wr" in again.stdout
    assert [len(frame["poses"]) for frame in frames_in(folder / "all.json")] == [0]
    assert "cell.json: already there" in run("perceive", *call, cwd=folder).stdout
    other = run("perceive", "new/cell.json", *call[1:], cwd=folder)
    assert "new/cell.json: perceived again, since image cell_grey.png changed" in other.stdout
    results = folder / "found" / "cell_poses.json"
    content = json.loads(results.read_text())
    del content["frames"][0]["inputs"]  # as older versions wrote
    results.write_text(json.dumps(content))
    older = run("perceive", "new/cell.json", *call[1:], cwd=folder)
    assert "perceived again, since its results do not say which files they are of" in older.stdout


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ([], "the bin must be known: give --bin"),
        (["--bin-pose", *POSE], "the bin must be known: give --bin"),
        (["--find-bin", "--bin", "400x300x100"], "--find-bin measures place and size: leave out --bin and --bin-pose"),
        (["--trust", "bin", "--bin", "400x300x100"], "--trust bin needs the place of the bin"),
        (["--no-measure-bin", "--bin", "400x300x100"], "takes the bin as it is stated: give --bin and --bin-pose, or"),
        (["--no-measure-bin", "--find-bin"], "takes the bin as it is stated: give --bin and --bin-pose, or leave"),
        (["--no-bin", "--bin", "400x300x100"], "or none by --no-bin, but not both"),
        (["--bin", "40x30x10", "--bin-pose", *POSE], "the part must fit into the bin, got a part of"),
        (["--bin", "400x300x100", "--bin-pose", *POSE[:15]], "or one JSON file of them, got 15 numbers (--bin-pose on"),
        (["--bin", "400x300x100", "--bin-pose", *POSE[:15], "x"], "T_world_bin must be 16 numbers row by row, got"),
        (["--bin", "400x300x100", "--bin-pose", "lost.json"], "16 numbers row by row (--bin-pose on the command line)"),
        (["--bin", "400x300x100", "--bin-pose", "full.npz"], "T_world_bin: full.npz is no JSON file"),
        (["--bin", "400x300x100", "--bin-pose", "empty.json"], "T_world_bin: empty.json has no key 'T_world_bin'"),
        (["--bin", "360", "260", "120"], "got 360 x 260 x 120 m: three words are metres, one word such as"),
        (["--bin", "360", "260", "120"], "is millimetres; type --bin 360x260x120 if millimetres were meant"),
        (
            ["--bin", "36", "26", "12"],
            "is millimetres; type --bin 360x260x120 if centimetres were meant or --bin 914.4x",
        ),
        (["--bin", "0.36x0.26x0.12"], "is millimetres; type --bin 360x260x120 if metres were meant"),
        (["--bin", "36x26x12"], "; --bin in one word is millimetres: type --bin 360x260x120 if centimetres were meant"),
        (["--bin", "0.36", "0.26", "0"], "is millimetres; type its inner sides"),
        (["--no-bin", "--grey", "{stem}_lost.png"], "there is no grey image full_lost.png: check --grey"),
        (["--no-bin", "--calibration", "lost.json"], "there is no calibration lost.json"),
        (
            ["--no-bin", "--depth-scale", "-1"],
            "scale must be a positive length [m] per unit, got -1.0 (--depth-scale on",
        ),
        (["--no-bin", "--grey", "one.png"], "several frames need a grey image each, got 'one.png'"),
    ],
)
def test_options_without_a_meaning_are_refused(options: list[str], error: str, folder: Path) -> None:
    done = run("perceive", "full.npz", "empty.json", "--part", "ell.stl", *options, cwd=folder)
    assert done.returncode == 2
    assert error in done.stderr


def test_frames_of_the_same_name_are_refused_only_where_files_are_written(folder: Path) -> None:
    write_frame(EMPTY, folder / "other" / "full.npz")
    call = ["full.npz", "other/full.npz", *IN_BIN]
    done = run("perceive", *call, "--overlay", "seen", cwd=folder)
    assert done.returncode == 2
    assert "the results of full.npz and other/full.npz would have the same name full" in done.stderr
    assert run("perceive", *call, cwd=folder).returncode == 0


def test_a_call_without_a_frame_is_refused(folder: Path) -> None:
    done = run("perceive", *IN_BIN, cwd=folder)
    assert done.returncode == 2


def test_a_folder_is_perceived_resumed_and_survives_bad_files(folder: Path) -> None:
    frames = folder / "frames"
    for name, frame in (("full.npz", FRAME), ("empty.json", EMPTY)):
        write_frame(frame, frames / name)
    (frames / "bad.npz").write_bytes(b"PK\x03\x04 nothing")
    call = ["--frames", "frames", *IN_BIN, "--bop", "found.csv"]
    done = run("perceive", *call, cwd=folder)
    assert done.returncode == 1
    assert "error: frames/bad.npz: bad.npz must be a complete file" in done.stderr
    assert "frames    3: 1 with parts, 1 without, 1 could not be read" in done.stdout
    out = folder / "runs" / "perceive-ell-frames"
    assert {path.name for path in out.glob("*.json")} == {"config.json", "full_poses.json", "empty_poses.json"}
    rows = (folder / "found.csv").read_text().splitlines()
    assert [row.split(",")[:3] for row in rows[1:]] == 2 * [["1", "2", "1"]]
    (frames / "bad.npz").unlink()
    again = run("perceive", *call, cwd=folder)
    assert again.returncode == 0
    assert again.stdout.count("already there") == 2
    assert "frames    2: 1 with parts, 1 without" in again.stdout
    assert [row.split(",")[:3] for row in (folder / "found.csv").read_text().splitlines()[1:]] == 2 * [["1", "1", "1"]]


def test_another_folder_of_the_same_name_is_not_mixed_in(folder: Path) -> None:
    write_frame(EMPTY, folder / "frames" / "one.npz")
    write_frame(EMPTY, folder / "other" / "frames" / "one.npz")
    assert run("perceive", "--frames", "frames", *IN_BIN, cwd=folder).returncode == 0
    other = run("perceive", "--frames", "other/frames", *IN_BIN, cwd=folder)
    assert other.returncode == 2
    assert "holds poses of another configuration (folder: " in other.stderr


@pytest.mark.parametrize(
    ("options", "error"),
    [
        (["full.npz", "--frames", "."], "name files of frames or a folder by --frames, but not both, got full.npz"),
        (["--frames", "lost"], "there is no folder lost"),
        (["--frames", ".", "--out", "."], "--out must be another folder than that of the frames, got ."),
        (["--frames", ".", "--overlay", "."], "--overlay must be another folder than that of the frames, got ."),
        (["full.npz", "--bop", "a.csv", "--bop-object", "-1"], "obj_id must not be negative, got -1"),
    ],
)
def test_folders_without_a_meaning_are_refused(options: list[str], error: str, folder: Path) -> None:
    done = run("perceive", *options, *IN_BIN, cwd=folder)
    assert done.returncode == 2
    assert error in done.stderr


def test_a_lost_frame_is_named_before_the_network_is_loaded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SegmentationPredictor, "from_file", None)
    done = run("perceive", "lost.png", *IN_BIN, cwd=folder)
    assert (done.returncode, done.stderr) == (2, "error: there is no frame lost.png\n")


def test_a_grid_may_be_one_word(folder: Path) -> None:
    height, width = FRAME.depth.shape
    points = deproject_depth(FRAME.K, FRAME.depth).reshape(-1, 3)
    np.save(folder / "points.npy", points)
    options = ["--part", "ell.stl", "--no-bin", "--json", "one.json"]
    done = run("perceive", "points.npy", *options, "--grid", f"{width}x{height}", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert f"points.npy: organised cloud, {width} x {height} px" in done.stdout


def test_a_part_larger_than_all_that_is_measured_is_a_wrong_unit_of_depth(folder: Path) -> None:
    write_frame(replace(FRAME, depth=FRAME.depth / 100), folder / "small.npz")
    done = run("perceive", "small.npz", "--part", "ell.stl", "--no-bin", cwd=folder)
    assert done.returncode == 1
    assert "the part must fit into what the frame measures, got a part of" in done.stderr
    assert "mm: check the depth's unit (--depth-scale), or that of the part's file (--unit)" in done.stderr


def test_a_bin_in_a_robots_world_without_the_cameras_pose_is_said_once(folder: Path) -> None:
    write_frame(replace(FRAME, T_world_cam=np.eye(4)), folder / "plain.npz")
    away = [f"{value:g}" for value in make_transform(translation=(0.5, 0.2, -0.3)).ravel()]
    options = ["--part", "ell.stl", "--bin", "400x300x100", "--bin-pose", *away]
    done = run("perceive", "plain.npz", *options, cwd=folder)
    assert done.returncode == 0
    assert (
        "(--bin-pose and --camera-pose); T_world_cam is the identity: if the bin's pose is that in a robot's"
        in done.stdout
    )
    assert (done.stdout + done.stderr).count("the frame shows no bin where it should be") == 1
