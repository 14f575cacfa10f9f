import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from binpick_env.evaluation.segmentation import ablation, evaluation
from binpick_env.evaluation.segmentation.ablation import AblationConfig, trainings
from binpick_env.evaluation.segmentation.ablation_summary import AblationTable
from perception.segmentation.networks.grid_net import GridNet, GridNetConfig
from perception.segmentation.weights import save_network
from policies.commands import evaluate_segmentation as evaluate
from tests.binpick_env.evaluation.segmentation.tiny_trainings import tiny_trainings
from tests.policies.commands.command_calls import run

JUDGED = ["--min-parts", "2", "--max-parts", "3", "--width", "320", "--height", "240", "--seed", "7"]


@pytest.fixture
def tiny_weights(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.safetensors"
    save_network(path, GridNet(GridNetConfig(widths=(4, 4, 4, 4, 4), hidden=8, embedding=4)), {"parts": ["tee"]})
    return path


@pytest.mark.slow
def test_evaluate_segmentation_judges_resumes_and_refuses_another_method(tmp_path: Path, tiny_weights: Path) -> None:
    out, facts = tmp_path / "run", tmp_path / "new" / "facts.json"
    common = [*JUDGED, "--weights", str(tiny_weights), "--out", str(out)]
    arguments = ["--count", "2", "--workers", "1", "--html", "--gallery", "1"]
    done = run("evaluate-segmentation", *arguments, *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "tee · tiny.safetensors, own · sensor good · 2 scenes · seed 7" in done.stdout
    assert "hand-labelled real scenes" in done.stdout.replace("\n", " ")
    assert (out / "report.html").read_text().count("<h3>Scene") == 1
    made = (out / "scene_00000.npz").stat().st_mtime_ns
    arguments = ["--count", "3", "--workers", "1", "--json", str(facts)]
    done = run("evaluate-segmentation", *arguments, *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    numbers = json.loads(facts.read_text())
    assert numbers["scenes"] == 3
    assert {"ap", "ap50", "ap75", "ap25", "ms_per_scene", "intervals", "by_visible_fraction", "clutter"} <= set(numbers)
    assert (out / "scene_00000.npz").stat().st_mtime_ns == made
    done = run("evaluate-segmentation", "--method", "euclidean", *common, cwd=tmp_path)
    assert done.returncode == 2
    assert "choose another folder with --out" in done.stderr


@pytest.mark.slow
def test_evaluate_segmentation_prints_the_ablation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_table = ablation.run_ablation

    def with_tiny_networks(config: AblationConfig, *arguments: Any) -> AblationTable:
        assert config.trainings == trainings()
        return make_table(replace(config, trainings=tiny_trainings()), *arguments)

    monkeypatch.setattr(ablation, "run_ablation", with_tiny_networks)
    out = tmp_path / "ablation"
    for use, seed in (("training", "0"), ("validation", "1")):
        make = ["--part", "part_a", "--count", "1", "--seed", seed, "--out", str(out / use), *JUDGED[:-2]]
        assert run("generate-scenes", *make, cwd=tmp_path).returncode == 0
    given = ["--scenes", str(out / "training"), "--validation", str(out / "validation")]
    budget = ["--count", "1", "--steps", "1", "--training-seeds", "1", "--workers", "1"]
    arguments = ["--ablation", "--part", "part_a", *given, *budget, *JUDGED, "--out", str(out)]
    done = run("evaluate-segmentation", *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    added = ("+ focal double hinge", "+ distance mask", "+ all points grouped")
    for row in ("Euclidean components", "SGPN: PointNet", "DGCNN", *added, "ours"):
        assert f"\n{row}" in done.stdout
    numbers = json.loads((out / "results.json").read_text())
    paper = [row["paper"]["ap50"] if row["paper"] else None for row in numbers["rows"]]
    assert paper == [None, 0.127, 0.276, 0.461, 0.505, None, None]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--part", "odd.stl"], "there is no part file odd.stl"),
        (["--weights", "nowhere.safetensors"], "nowhere.safetensors"),
        (["--method", "euclidean", "--part", "teapot"], "part must be one of part_a"),
        (["--method", "euclidean", "--count", "0"], "count and workers must be at least 1, got 0 and 2"),
        (["--method", "euclidean", "--radius", "0"], "radius must be positive, got 0.0"),
        (["--ablation", "--seed", "0"], "the training scenes are those of seed 0, which are evaluated; choose another"),
    ],
)
def test_evaluate_segmentation_says_a_users_mistake_in_one_line(
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


def test_evaluate_segmentation_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop(config: object, count: int, out: Path, workers: int, **_: object) -> Iterator[int]:
        assert (count, out, workers) == (4, tmp_path, 3)
        yield 0
        raise KeyboardInterrupt

    monkeypatch.setattr(evaluation, "evaluate_scenes", stop)
    assert evaluate.run(evaluate.Arguments(method="euclidean", count=4, workers=3, out=tmp_path)) == 130
    assert f"what is finished is kept in {tmp_path}: the same command goes on" in capsys.readouterr().err
