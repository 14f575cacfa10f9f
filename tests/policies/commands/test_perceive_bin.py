"""`binpick perceive` where the bin is measured, looked for or trusted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from perception.capture import write_frame
from perception.frame import Frame
from perception.geometry import make_transform
from perception.pipeline import Perception, Pipeline
from policies.frames import frame_perceiver
from tests.perception.diagnosis import bin_scene
from tests.policies.commands.command_calls import run
from tests.policies.commands.perceive_calls import frames_in
from tests.rerun_rows import rows_of

IN_WALLS = bin_scene.good()[0]
WALLED = [f"{value:.12g}" for value in bin_scene.BIN.T_world_bin.ravel()]
NEAR = [
    f"{value:.12g}" for value in (make_transform(translation=(0.01, 0.0, 0.01)) @ bin_scene.BIN.T_world_bin).ravel()
]
SIZE = "240x180x80"


@pytest.mark.parametrize(
    "options", [["--find-bin"], ["--bin", SIZE], ["--bin", SIZE, "--bin-pose", *NEAR]], ids=["all", "place", "pose"]
)
def test_the_bin_is_measured_in_the_frame(folder: Path, options: list[str]) -> None:
    write_frame(IN_WALLS, folder / "walls.npz")
    done = run("perceive", "walls.npz", "--part", "ell.stl", *options, "--json", "walls.json", cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    (frame,) = frames_in(folder / "walls.json")
    facts = frame["report"]["bin"]
    assert facts["measured"]
    np.testing.assert_allclose(frame["bin"]["inner_size"], bin_scene.BIN.inner_size, atol=0.0015)
    T = np.array(frame["bin"]["T_world_bin"])
    np.testing.assert_allclose(T[:3, 3], bin_scene.BIN.T_world_bin[:3, 3], atol=0.0015)
    assert "the bin was measured by floor, rim, 4 walls: " in done.stdout
    assert (facts["distance"] is None) == ("--bin-pose" not in options)


def test_a_bin_that_was_found_limits_the_poses(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bins = []

    class Spy(Pipeline):
        def perceive(self, frame: Frame) -> Perception:
            bins.append(self.estimator.workspace)
            return super().perceive(frame)

    monkeypatch.setattr(frame_perceiver, "Pipeline", Spy)
    write_frame(IN_WALLS, folder / "walls.npz")
    assert run("perceive", "walls.npz", "--part", "ell.stl", "--find-bin", cwd=folder).returncode == 0
    assert run("perceive", "walls.npz", "--part", "ell.stl", "--no-bin", cwd=folder).returncode == 0
    np.testing.assert_allclose(bins[0].T_world_bin[:3, 3], bin_scene.BIN.T_world_bin[:3, 3], atol=0.0015)
    assert bins[1] is None


def test_a_trusted_bin_corrects_the_camera(folder: Path) -> None:
    wrong = IN_WALLS.T_world_cam @ make_transform(translation=(0.01, 0.0, 0.01))
    write_frame(replace(IN_WALLS, T_world_cam=wrong), folder / "walls.npz")
    options = ["--part", "ell.stl", "--bin", SIZE, "--bin-pose", *WALLED, "--trust", "bin", "--json", "walls.json"]
    assert run("perceive", "walls.npz", *options, cwd=folder).returncode == 0
    (frame,) = frames_in(folder / "walls.json")
    np.testing.assert_allclose(frame["bin"]["T_world_bin"], bin_scene.BIN.T_world_bin, atol=1e-9)
    np.testing.assert_allclose(np.array(frame["T_world_cam"])[:3, 3], IN_WALLS.T_world_cam[:3, 3], atol=0.003)


def test_a_stated_bin_is_taken_as_it_is_on_request(folder: Path) -> None:
    write_frame(IN_WALLS, folder / "walls.npz")
    options = ["--part", "ell.stl", "--bin", SIZE, "--bin-pose", *NEAR, "--no-measure-bin", "--json", "walls.json"]
    assert run("perceive", "walls.npz", *options, cwd=folder).returncode == 0
    (frame,) = frames_in(folder / "walls.json")
    assert frame["report"]["bin"] is None
    assert frame["bin"]["T_world_bin"][2][3] == pytest.approx(bin_scene.BIN.T_world_bin[2, 3] + 0.01)


def test_everything_is_searched_where_no_bin_is_found(folder: Path) -> None:
    options = ["--part", "ell.stl", "--bin", SIZE, "--json", "full.json"]
    done = run("perceive", "full.npz", *options, cwd=folder)
    assert done.returncode == 0
    (frame,) = frames_in(folder / "full.json")
    assert frame["bin"] is None
    assert not frame["report"]["bin"]["measured"]
    assert "the bin was not measured: its rim was not found" in done.stdout
    assert "no bin limits the poses" in done.stdout
    assert done.stdout.index("the bin was not measured") < done.stdout.index("no bin limits the poses")
    assert "region searched: " in done.stdout
    assert "in the bin" not in done.stdout
    assert done.stderr == ""  # no warning about a bin that nobody gave


def test_a_recording_has_no_bin_where_the_frame_has_none(folder: Path) -> None:
    write_frame(IN_WALLS, folder / "walls.npz")
    options = ["--part", "ell.stl", "--bin", SIZE, "--rerun", "seen.rrd"]
    assert run("perceive", "walls.npz", "full.npz", *options, cwd=folder).returncode == 0
    assert rows_of(folder / "seen.rrd")["/world/bin"] == 2  # the second one clears the first


@pytest.mark.parametrize(
    ("size", "text"),
    [
        ("232x172x80", "likely cause: the bin's opening measures 2"),
        ("480x360x160", "was seen where 480 x 360 mm was said, 0.5 times as long and as wide: check the depth's unit"),
    ],
)
def test_a_bin_of_another_size_is_a_cause(folder: Path, size: str, text: str) -> None:
    write_frame(IN_WALLS, folder / "walls.npz")
    done = run("perceive", "walls.npz", "--part", "ell.stl", "--bin", size, cwd=folder)
    assert done.returncode == 0
    assert text in done.stdout


def test_parts_on_a_table_are_found_without_a_bin(folder: Path) -> None:
    done = run("perceive", "full.npz", "--part", "ell.stl", "--find-bin", "--json", "full.json", cwd=folder)
    assert done.returncode == 0
    (frame,) = frames_in(folder / "full.json")
    assert frame["report"]["bin"]["seen"] == ["floor"]
    assert [pose["verified"] for pose in frame["poses"]] == [True, True]
