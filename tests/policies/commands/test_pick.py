import json
import logging
import shlex
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh

from binpick_env.observation import pixel_perceiver
from perception.segmentation import weights
from policies.commands import pick, train_segmentation
from policies.commands.command_line import parse
from policies.evaluation import jobs
from policies.evaluation.bin_evaluation import BinError
from policies.evaluation.config import EvaluationConfig
from policies.picking.settings import PickerSettings
from tests.policies.commands.command_calls import TINY, run
from tests.policies.fake_cell import dice_cell


def test_help_names_every_argument_of_the_contract() -> None:
    text = run("pick", "--help").stdout
    for name in ("part", "bins", "seed", "perception", "sensor", "workers", "out", "json", "video", "html", "budget"):
        assert f"--{name}" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--part", "teapot"], "part must be one of part_a, part_b, part_c, tee, bracket"),
        (["--part", "nowhere.stl"], "nowhere.stl"),
        (["--bins", "0"], "bins and workers must be at least 1, got 0 and 1"),
        (["--video", "film.avi"], "must end in .mp4"),
        (["--budget", "--video", "film.mp4"], "a budget is three evaluations and films none"),
        (["--min-parts", "5", "--max-parts", "4"], "num_parts must be a rising pair"),
    ],
)
def test_a_users_mistake_is_one_line_and_exit_code_2(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = pick.main([*arguments, "--out", str(tmp_path)])
    error = capsys.readouterr().err
    assert code == 2
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert message in error


def test_ctrl_c_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(jobs, "run_job", interrupted)
    assert pick.run(pick.Arguments(perception="oracle", out=tmp_path)) == 130
    assert f"finished bins are kept in {tmp_path}: the same command resumes there" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (BinError("bin 3 (seed 7) failed: SettleError: no rest"), "bin 3 (seed 7) failed: SettleError: no rest"),
        (BinError("a worker was killed"), "a worker was killed"),
    ],
)
def test_a_bin_that_fails_is_one_line_and_exit_code_2(
    fault: Exception,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise fault

    monkeypatch.setattr(jobs, "run_job", fail)
    assert pick.run(pick.Arguments(perception="oracle", out=tmp_path)) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert message in line


@pytest.mark.slow
def test_pick_runs_resumes_and_refuses_another_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """In test_main.py, a script shows its status."""
    monkeypatch.setattr(pixel_perceiver, "_warmed_up", set())
    out, film = tmp_path / "run", tmp_path / "film.mp4"
    common = [*TINY, "--perception", "learned", "--out", str(out)]
    with caplog.at_level(logging.INFO):
        done = run("pick", "--bins", "1", "--video", str(film), "--video-limit", "1", *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "GSR" in done.stdout
    for status in (
        "loading the simulator",
        "loading the segmentation network",
        "loading the kernels",
        "building the cell",
    ):
        assert status in caplog.text
    assert film.stat().st_size > 1000
    assert "src='data:image/webp;base64," in (out / "report.html").read_text()
    assert (out / "bin_0000_pick_00.webp").stat().st_size < 40_000
    assert json.loads((out / "results.json").read_text())["ap"] > 0.5  # from pixels, of two parts
    made = (out / "bin_0000.json").stat().st_mtime_ns
    done = run("pick", "--bins", "2", "--workers", "2", "--json", str(tmp_path / "n.json"), *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "1 of 2 bins were there already, made by commit" in done.stdout
    numbers = json.loads((tmp_path / "n.json").read_text())
    assert numbers["bins"] == 2
    assert numbers["parts_total"] == 4
    assert (out / "bin_0000.json").stat().st_mtime_ns == made
    done = run("pick", "--bins", "2", "--seed", "1", *common, cwd=tmp_path)
    assert done.returncode == 2
    assert "--out" in done.stderr


@pytest.mark.slow
def test_a_file_is_said_as_it_was_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    trimesh.creation.box((60, 40, 30)).export(tmp_path / "block.stl")

    configs: list[EvaluationConfig] = []

    def stop(config: EvaluationConfig, *_: object, **__: object) -> None:
        configs.append(config)
        raise BinError("far enough")

    monkeypatch.setattr(jobs, "run_job", stop)
    trimesh.creation.box((0.05, 0.03, 0.02)).export(tmp_path / "metres.stl")
    file = ["--part", str(tmp_path / "block.stl"), "--out", str(tmp_path / "out"), "--perception", "oracle"]
    for arguments, said in (
        ([], "block.stl: read as mm, d_max 78 mm, symmetry order 4, 2700 kg/m^3"),
        (["--symmetry", "none", "--density", "1240"], "block.stl: read as mm, d_max 78 mm, symmetry order 1, 1240 kg/"),
    ):
        assert pick.main([*file, *arguments]) == 2
        assert said in capsys.readouterr().out
    assert [config.density for config in configs] == [None, 1240.0]
    assert pick.main(["--part", str(tmp_path / "metres.stl"), "--unit", "m", *file[2:]]) == 2
    assert "metres.stl: read as m, d_max 62 mm, symmetry order 4" in capsys.readouterr().out
    assert configs[2].unit == "m"
    assert pick.main([*file, "--unit", "inch"]) == 2
    assert "--unit" in capsys.readouterr().err


@pytest.mark.slow
def test_a_budget_picks_the_same_bins_three_ways(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page on budgets, whose lines tests/test_shell_lines.py runs, picks them in real cells."""
    monkeypatch.setattr(jobs, "run_job", partial(jobs.run_job, make_cell=dice_cell))
    arguments = ["--budget", "--bins", "1", "--no-html", *TINY, "--out", str(tmp_path / "out")]
    done = run("pick", *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "segmentation (gt_masks - learned)" in done.stdout
    numbers = json.loads((tmp_path / "out" / "budget.json").read_text())
    assert set(numbers["costs"]) == {"pose", "segmentation", "both"}
    for mode in ("oracle", "gt_masks", "learned"):
        record = json.loads((tmp_path / "out" / mode / "bin_0000.json").read_text())
        assert record["parts_total"] == 2
        assert numbers["modes"][mode]["config"]["perception"] == mode
    made = (tmp_path / "out" / "gt_masks" / "bin_0000.json").stat().st_mtime_ns
    assert "1 of 1 bins were there already" in run("pick", *arguments, cwd=tmp_path).stdout
    assert (tmp_path / "out" / "gt_masks" / "bin_0000.json").stat().st_mtime_ns == made


@pytest.mark.usefixtures("coarse_grasps")
def test_a_part_without_weights_gets_the_commands_that_make_them_and_the_other_modes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(weights, "SHIPPED", tmp_path / "nothing")  # the shipped network serves every part
    trimesh.creation.box((60, 40, 30)).export(tmp_path / "block.stl")
    block = tmp_path / "a folder" / "block.stl"
    block.parent.mkdir()
    (tmp_path / "block.stl").rename(block)
    arguments = ["--part", str(block), "--unit", "mm", "--perception", "learned", "--out", str(tmp_path / "out")]
    assert pick.main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    for told in ("binpick generate-scenes", "binpick train-segmentation", "'gt_masks'", "'oracle'"):
        assert told in line
    command = shlex.split(line.split("weights of this part alone: ")[1])
    assert command[:6] == ["binpick", "train-segmentation", "--part", str(block), "--unit", "mm"]
    assert parse(train_segmentation.Arguments, "train-segmentation", command[2:]).part == (str(block),)
    assert not (tmp_path / "out").exists()
    assert pick.main([*arguments, "--network", "dgcnn-sgpn"]) == 2
    command = shlex.split(capsys.readouterr().err.split("weights of this part alone: ")[1])
    training = parse(train_segmentation.Arguments, "train-segmentation", command[2:])
    assert (training.preset, training.install) == ("dgcnn-sgpn", True)


def test_pushes_and_put_backs_are_on_unless_they_are_switched_off() -> None:
    both, neither = pick.Arguments().config().picker, pick.Arguments(push=False, put_back=False).config().picker
    assert both == PickerSettings()
    assert (both.push.enabled, both.doubles.put_back) == (True, True)
    assert (neither.push.enabled, neither.doubles.put_back) == (False, False)


def test_frames_are_taken_ahead_unless_that_is_switched_off() -> None:
    neither = pick.Arguments(push=False, put_back=False, look_ahead=False).config().picker
    assert pick.Arguments().config().picker.execution.look_ahead
    assert neither == PickerSettings().attempts_only()


def test_tilt_and_restarts_of_inverse_kinematics_arrive() -> None:
    picker = pick.Arguments(max_tilt_deg=90.0, ik_restarts=0).config().picker
    assert (picker.rank.max_tilt, picker.ik.restarts) == (pytest.approx(np.pi / 2), 0)


@pytest.mark.parametrize("degrees", [0.0, 91.0, np.nan])
def test_a_tilt_that_is_none_is_refused_in_the_options_unit(degrees: float) -> None:
    with pytest.raises(ValueError, match=f"max_tilt_deg must be over 0 and at most 90 degrees, got {degrees}"):
        pick.Arguments(max_tilt_deg=degrees).config()


def test_a_negative_number_of_restarts_is_refused_by_its_option() -> None:
    with pytest.raises(ValueError, match="ik_restarts must be at least 0, got -1"):
        pick.Arguments(ik_restarts=-1).config()


def test_parts_that_others_lie_on_are_avoided_unless_that_is_switched_off() -> None:
    assert pick.Arguments(avoid=False).config().picker == PickerSettings(most_buried=1.0)
