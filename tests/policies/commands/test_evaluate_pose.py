"""scripts/evaluate_pose.py from the command line to its files."""

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
import torch

from perception.segmentation.networks.grid_net import GridNet, GridNetConfig
from perception.segmentation.weights import save_network

ROOT = Path(__file__).resolve().parents[3]
SCRIPT = ROOT / "scripts" / "evaluate_pose.py"
SMALL = ["--min-parts", "2", "--max-parts", "3", "--sensor", "none", "--seed", "31"]


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    command = [sys.executable, str(SCRIPT), *arguments]
    return subprocess.run(command, cwd=cwd, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True)


@pytest.fixture
def evaluate() -> ModuleType:
    spec = importlib.util.spec_from_file_location("script_evaluate_pose", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module  # dataclasses look their own module up
    spec.loader.exec_module(module)
    return module


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
    done = run("--count", "1", "--html", "--table3", "--workers", "1", *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "bracket · true segments · sensor none · 1 scenes · seed 31" in done.stdout
    assert "paper, Part A" in done.stdout
    assert (out / "report.html").read_text().count("<h3>Scene") == 1
    made = (out / "scene_00000.npz").stat().st_mtime_ns
    done = run("--count", "2", "--json", str(facts), *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    numbers = json.loads(facts.read_text())
    contract = {"recognition_rate", "trials", "recall", "precision", "ms_segmentation", "ms_pose", "ms_per_group"}
    beside = {"intervals", "clutter", "versions", "git_commits", "ap", "ap50", "ap75", "explained", "reliability"}
    assert contract | beside <= set(numbers)
    assert numbers["scenes"] == 2
    assert numbers["recognition_rate"] == numbers["recall"] == 1.0  # two or three parts without noise
    assert numbers["translation_mm"]["median"] < 1.0
    assert (out / "scene_00000.npz").stat().st_mtime_ns == made
    done = run("--min-score", "0.9", *common, cwd=tmp_path)
    assert done.returncode == 2
    assert "method.estimator.min_score" in done.stderr
    assert "choose another folder with --out" in done.stderr


@pytest.mark.slow
def test_it_takes_learned_segments_and_whole_scenes(tmp_path: Path, tiny_weights: Path) -> None:
    for perception, more in (("learned", ["--weights", str(tiny_weights)]), ("whole_scene", [])):
        arguments = ["--part", "bracket", "--perception", perception, "--count", "1", "--workers", "1", *more]
        done = run(*arguments, *SMALL, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        numbers = json.loads((tmp_path / f"runs/pose-eval-bracket-{perception}-31/results.json").read_text())
        assert numbers["perception"] == perception
        assert (numbers["weights"] is None) == (perception == "whole_scene")
        assert (numbers["ms_segmentation"] > 0) == (perception == "learned")


@pytest.mark.slow
def test_it_prints_the_ablation(tmp_path: Path) -> None:
    out = tmp_path / "ablation"
    arguments = ["--part", "bracket", "--ablation", "--count", "1", "--workers", "1", "--out", str(out)]
    done = run(*arguments, *SMALL, cwd=tmp_path)
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
        (["--part", "odd.stl"], "there are no segmentation weights for 'odd': train them with scripts/generate_scenes"),
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
    evaluate: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    out = ["--out", str(tmp_path / "out")]
    assert evaluate.main(evaluate.tyro.cli(evaluate.Arguments, args=[*arguments, *out])) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert message in line
    assert not (tmp_path / "out").exists()


def test_it_says_how_to_go_on(
    tmp_path: Path, evaluate: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop(*_: object, **__: object) -> Iterator[int]:
        yield 0
        raise KeyboardInterrupt

    monkeypatch.setattr(evaluate, "evaluate_poses", stop)
    assert evaluate.main(evaluate.Arguments(perception="gt_masks", out=tmp_path)) == 130
    assert f"what is finished is kept in {tmp_path}: the same command goes on" in capsys.readouterr().err
