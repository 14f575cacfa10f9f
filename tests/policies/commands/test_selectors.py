"""fit_noise.py, check_fast.py, train_selector.py and evaluate_selector.py, each from its command line."""

import json
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from binpick_env.evaluation.noise_fit import FrameObservation, PartObservation
from binpick_env.observation.perception_noise import PerceptionNoise
from policies.grasping.outcomes import GraspOutcome
from policies.selection.fast_agreement import Pair
from policies.selection.selectors import load_selector
from tests.policies.commands.test_scripts import load

FEW = ("--min-parts", "2", "--max-parts", "3")


def call(script: ModuleType, *arguments: object) -> int:
    return int(script.main(script.tyro.cli(script.Arguments, args=[str(argument) for argument in arguments])))


def test_a_noise_model_is_fitted_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script, asked = load("fit_noise.py"), {}
    row = PartObservation(
        visible_fraction=0.95,
        detected=True,
        correct=True,
        translation_error=0.001,
        rotation_error=0.02,
        score=0.9,
        estimated_fraction=0.9,
    )

    def looked(part: str, bins: int, seed: int, **settings: Any) -> list[FrameObservation]:
        asked.update(part=part, bins=bins, seed=seed, **settings)
        return [FrameObservation(parts=(row, PartObservation(visible_fraction=0.95)), false_scores=())] * bins

    monkeypatch.setattr(script, "observe_bins", looked)
    out = tmp_path / "tee_harsh.json"
    assert call(script, "--part", "tee", "--bins", 5, "--seed", 31, "--sensor", "harsh", "--json", out) == 0
    assert asked == {"part": "tee", "bins": 5, "seed": 31, "sensor": "harsh", "num_parts": (2, 30), "workers": 1}
    noise = PerceptionNoise.load(out)
    assert (noise.bins[-1].offered, noise.bins[-1].count) == (0.5, 10)
    assert {"command", "commit", "seed", "bins"} <= noise.provenance.keys()
    assert "50.0 %" in capsys.readouterr().out
    monkeypatch.setattr(script, "observe_bins", lambda *_, **__: [FrameObservation(parts=(), false_scores=())])
    assert call(script, "--json", out) == 2
    assert "hold no correct pose" in capsys.readouterr().err


def test_fast_and_full_are_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script = load("check_fast.py")
    made: list[dict[str, Any]] = []
    monkeypatch.setattr(script, "GraspSelectionEnv", lambda **settings: made.append(settings))
    pair = Pair(full=GraspOutcome.DELIVERED, fast=GraspOutcome.DELIVERED, seconds=(2.0, 1.0), shift=0.0)
    monkeypatch.setattr(script, "paired_attempts", lambda full, fast, seed, count: iter([pair] * count))
    assert call(script, "--attempts", 4, "--json", tmp_path / "pairs.json") == 0
    assert [settings["fast"] for settings in made] == [False, True]
    assert "4 / 4" in capsys.readouterr().out
    assert len(json.loads((tmp_path / "pairs.json").read_text())["pairs"]) == 4
    assert call(script, "--part", "tee", "--attempts", 1, "--min-parts", 3) == 0

    def refuse(**_: Any) -> None:
        raise ValueError("num_parts must be a rising pair")

    monkeypatch.setattr(script, "GraspSelectionEnv", refuse)
    assert call(script) == 2
    assert "error: num_parts" in capsys.readouterr().err


@pytest.mark.slow
def test_selectors_are_trained_and_evaluated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From logged attempts over PPO to the table, all of it tiny."""
    train, evaluate = load("train_selector.py"), load("evaluate_selector.py")
    tiny = (*FEW, "--fast", "--seed", "31")
    bandit = train.tyro.cli(train.Bandit, args=[*tiny, "--bins", "2", "--epochs", "2", "--out", str(tmp_path / "b")])
    assert train.bandit(bandit) == 0
    assert "on held-out bins: cross-entropy" in capsys.readouterr().out
    every = train.tyro.cli(train.Bandit, args=[*tiny, "--bins", "2", "--held-out", "0", "--out", str(tmp_path / "b")])
    assert train.bandit(every) == 0
    assert "on all bins, fitted: cross-entropy" in capsys.readouterr().out
    start = tmp_path / "b" / "selector.safetensors"
    more = ["--picks", "4", "--rollout", "4", "--initial", str(start), "--out", str(tmp_path / "p")]
    assert train.ppo(train.tyro.cli(train.Ppo, args=[*tiny, *more])) == 0
    trained = tmp_path / "p" / "selector.safetensors"
    load_selector(str(trained))
    kept = tmp_path / "e"
    common = (*FEW, "--perception", "oracle", "--seed", "31", "--bins", "1", "--out", kept)
    assert call(evaluate, *common, "--selectors", "weighted", trained, "hindsight") == 0
    shown = capsys.readouterr().out
    assert "best heuristic" in shown
    assert "hindsight (bound)" in shown
    numbers = json.loads((kept / "selectors.json").read_text())
    assert len(numbers["selectors"]) == 3
    assert numbers["best_heuristic"] == "weighted"


def test_what_makes_bins_hard_arrives() -> None:
    train, evaluate = load("train_selector.py"), load("evaluate_selector.py")
    size = ["--bin", "0.3", "0.2", "0.15"]
    assert evaluate.tyro.cli(evaluate.Arguments, args=size).config().bin == (0.3, 0.2, 0.15)
    assert evaluate.tyro.cli(evaluate.Arguments, args=[]).config().bin is None
    hard = ["--hand-eye", "0.01", "--sensor", "harsh"]
    config = evaluate.tyro.cli(evaluate.Arguments, args=hard).config()
    assert (config.camera.hand_eye, config.sensor) == (0.01, "harsh")
    for method in (train.Ppo, train.Bandit):
        cells = train.tyro.cli(method, args=["--hand-eye-mm", "10", "--sensor", "harsh"]).cells
        assert (cells.hand_eye_mm, cells.sensor) == (10.0, "harsh")
        assert train.tyro.cli(method, args=size).cells.bin == (0.3, 0.2, 0.15)
        assert train.tyro.cli(method, args=[]).cells.bin is None


def test_mistakes_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    train, evaluate = load("train_selector.py"), load("evaluate_selector.py")
    assert call(evaluate, "--perception", "oracle", "--selectors", "oracle", "--out", tmp_path) == 2
    assert "error: a selector must be one of random" in capsys.readouterr().err
    assert call(evaluate, "--bin", "0.3", "0", "0.1") == 2
    assert "error: inner_size must be positive, got (0.3, 0.0, 0.1)" in capsys.readouterr().err
    assert call(evaluate, "--perception", "oracle", "--bins", "0") == 2
    assert "error: bins and workers must be at least 1" in capsys.readouterr().err
    assert train.bandit(train.tyro.cli(train.Bandit, args=["--epsilon", "2", "--out", str(tmp_path)])) == 2
    assert "error: epsilon must be in [0, 1]" in capsys.readouterr().err
    assert train.ppo(train.tyro.cli(train.Ppo, args=["--rollout", "0", "--out", str(tmp_path)])) == 2
    assert "error: n_steps must be at least 1" in capsys.readouterr().err
