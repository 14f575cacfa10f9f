import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
import trimesh

from binpick_env.evaluation.pose import evaluation
from perception.segmentation.networks.grid_net import GridNet, GridNetConfig
from perception.segmentation.weights import save_network
from policies.commands import evaluate_pose as evaluate
from policies.commands import evaluate_segmentation
from tests.policies.commands.command_calls import run

SMALL = ["--min-parts", "2", "--max-parts", "3", "--sensor", "none", "--seed", "31"]


@pytest.fixture
def tiny_weights(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    path = tmp_path / "tiny.safetensors"
    save_network(path, GridNet(GridNetConfig(widths=(4, 4, 4, 4, 4), hidden=8, embedding=4)), {"parts": ["bracket"]})
    return path


@pytest.mark.slow
def test_it_judges_resumes_and_refuses_another_method(tmp_path: Path) -> None:
    out, facts = tmp_path / "run", tmp_path / "new" / "facts.json"
    common = [*SMALL, "--part", "bracket", "--perception", "gt_masks", "--out", str(out)]
    done = run("evaluate-pose", "--count", "1", "--html", "--table3", "--workers", "1", *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "bracket · true segments · sensor none · 1 scene · seed 31" in done.stdout
    assert "paper, Part A" in done.stdout
    assert (out / "report.html").read_text().count("<h3>Scene") == 1
    made = (out / "scene_00000.npz").stat().st_mtime_ns
    done = run("evaluate-pose", "--count", "2", "--json", str(facts), *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    numbers = json.loads(facts.read_text())
    contract = {"recognition_rate", "trials", "recall", "precision", "ms_segmentation", "ms_pose", "ms_per_group"}
    beside = {"intervals", "clutter", "versions", "git_commits", "ap", "ap50", "ap75", "explained", "reliability"}
    assert contract | beside <= set(numbers)
    assert numbers["scenes"] == 2
    assert numbers["recognition_rate"] == numbers["recall"] == 1.0  # two or three parts without noise
    assert numbers["translation_mm"]["median"] < 1.0
    assert (out / "scene_00000.npz").stat().st_mtime_ns == made
    done = run("evaluate-pose", "--min-score", "0.8", *common, cwd=tmp_path)
    assert done.returncode == 2
    assert "method.estimator.min_score" in done.stderr
    assert "choose another folder with --out" in done.stderr


@pytest.mark.slow
def test_it_takes_learned_segments_and_whole_scenes(tmp_path: Path, tiny_weights: Path) -> None:
    for perception, more in (("learned", ["--weights", str(tiny_weights)]), ("whole_scene", [])):
        arguments = ["--part", "bracket", "--perception", perception, "--count", "1", "--workers", "1", *more]
        done = run("evaluate-pose", *arguments, *SMALL, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        numbers = json.loads((tmp_path / f"runs/pose-eval-bracket-{perception}-31/results.json").read_text())
        assert numbers["perception"] == perception
        assert (numbers["weights"] is None) == (perception == "whole_scene")
        assert (numbers["ms_segmentation"] > 0) == (perception == "learned")


@pytest.mark.slow
def test_it_prints_the_ablation(tmp_path: Path) -> None:
    out = tmp_path / "ablation"
    arguments = ["--part", "bracket", "--ablation", "--count", "1", "--workers", "1", "--out", str(out)]
    done = run("evaluate-pose", *arguments, *SMALL, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for row in ("full method", "pairs of edges never seen together", "1 view", "6 views", "26 views"):
        assert f"\n{row}" in done.stdout
    numbers = json.loads((out / "results.json").read_text())
    assert len(numbers["rows"]) == 11
    assert numbers["rows"][0]["recognition_rate"] == 1.0
    assert numbers["rows"][1]["against_full"].keys() == {"recognition_rate", "recall", "precision"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--part", "odd.stl"], "there is no part file odd.stl"),
        (["--weights", "nowhere.safetensors"], "nowhere.safetensors"),
        (["--perception", "gt_masks", "--part", "teapot"], "part must be one of part_a"),
        (["--perception", "gt_masks", "--count", "0"], "count and workers must be at least 1, got 0 and 2"),
        (["--perception", "gt_masks", "--weights", "w"], "weights are for perception 'learned' alone"),
        (["--perception", "gt_masks", "--min-score", "2"], "min_score must be in [0, 1], got 2.0"),
        (["--ablation", "--part", "teapot"], "part must be one of part_a"),
    ],
)
def test_it_says_a_users_mistake_in_one_line(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    out = ["--out", str(tmp_path / "out")]
    assert evaluate.main([*arguments, *out]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert message in line
    assert not (tmp_path / "out").exists()


def test_it_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop(config: object, count: int, out: Path, workers: int, **_: object) -> Iterator[int]:
        assert (count, out, workers) == (4, tmp_path, 3)
        yield 0
        raise KeyboardInterrupt

    monkeypatch.setattr(evaluation, "evaluate_poses", stop)
    assert evaluate.run(evaluate.Arguments(perception="gt_masks", count=4, workers=3, out=tmp_path)) == 130
    assert f"what is finished is kept in {tmp_path}: the same command goes on" in capsys.readouterr().err


@pytest.mark.parametrize("command", [evaluate, evaluate_segmentation])
def test_missing_weights_name_the_command_with_the_parts_path_and_unit(
    command: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    block = tmp_path / "block.stl"
    trimesh.creation.box((60, 40, 30)).export(block)
    assert command.main(["--part", str(block), "--unit", "mm", "--network", "dgcnn-sgpn", "--no-html"]) == 2
    said = capsys.readouterr().err
    assert f"binpick train-segmentation --part {block} --unit mm --preset dgcnn-sgpn --install True" in said
