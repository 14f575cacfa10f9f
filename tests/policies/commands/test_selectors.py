"""`binpick fit-noise`, `check-fast`, `train-selector` and `evaluate-selector`, each from its command line."""

import json
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from binpick_env.evaluation import noise_fit
from binpick_env.evaluation.noise_fit import FrameObservation, PartObservation
from binpick_env.observation.perception_noise import PerceptionNoise
from policies.commands import check_fast, evaluate_selector, fit_noise, train_selector
from policies.commands.command_line import parse
from policies.grasping.outcomes import GraspOutcome
from policies.selection import env, fast_agreement
from policies.selection.fast_agreement import Pair
from policies.selection.selectors import load_selector

FEW = ("--min-parts", "2", "--max-parts", "3")


def call(command: ModuleType, *arguments: object) -> int:
    return int(command.main([str(argument) for argument in arguments]))


def test_a_noise_model_is_fitted_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: dict[str, Any] = {}
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

    monkeypatch.setattr(noise_fit, "observe_bins", looked)
    out = tmp_path / "tee_harsh.json"
    assert call(fit_noise, "--part", "tee", "--bins", 5, "--seed", 31, "--sensor", "harsh", "--json", out) == 0
    assert asked == {"part": "tee", "bins": 5, "seed": 31, "sensor": "harsh", "num_parts": (2, 30), "workers": 1}
    noise = PerceptionNoise.load(out)
    assert (noise.bins[-1].offered, noise.bins[-1].count) == (0.5, 10)
    assert {"command", "commit", "seed", "bins"} <= noise.provenance.keys()
    assert "50.0 %" in capsys.readouterr().out
    monkeypatch.setattr(noise_fit, "observe_bins", lambda *_, **__: [FrameObservation(parts=(), false_scores=())])
    assert call(fit_noise, "--json", out) == 2
    assert "hold no correct pose" in capsys.readouterr().err


def test_fast_and_full_are_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made: list[dict[str, Any]] = []
    monkeypatch.setattr(env, "GraspSelectionEnv", lambda **settings: made.append(settings))
    pair = Pair(full=GraspOutcome.DELIVERED, fast=GraspOutcome.DELIVERED, seconds=(2.0, 1.0), shift=0.0)
    monkeypatch.setattr(fast_agreement, "paired_attempts", lambda full, fast, seed, count: iter([pair] * count))
    assert call(check_fast, "--attempts", 4, "--json", tmp_path / "pairs.json") == 0
    assert [settings["fast"] for settings in made] == [False, True]
    assert "4 / 4" in capsys.readouterr().out
    assert len(json.loads((tmp_path / "pairs.json").read_text())["pairs"]) == 4
    assert call(check_fast, "--part", "tee", "--attempts", 1, "--min-parts", 3) == 0

    def refuse(**_: Any) -> None:
        raise ValueError("num_parts must be a rising pair")

    monkeypatch.setattr(env, "GraspSelectionEnv", refuse)
    assert call(check_fast) == 2
    assert "error: num_parts" in capsys.readouterr().err


@pytest.mark.slow
def test_selectors_are_trained_and_evaluated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From logged attempts over PPO to the table, all of it tiny."""
    tiny = (*FEW, "--fast", "--seed", "31")
    bandit = ("bandit", *tiny, "--bins", "2", "--out", tmp_path / "b")
    assert call(train_selector, *bandit, "--epochs", "2") == 0
    assert "on held-out bins: cross-entropy" in capsys.readouterr().out
    assert call(train_selector, *bandit, "--held-out", "0") == 0
    assert "on all bins, fitted: cross-entropy" in capsys.readouterr().out
    start = tmp_path / "b" / "selector.safetensors"
    more = ("--picks", "4", "--rollout", "4", "--initial", start, "--out", tmp_path / "p")
    assert call(train_selector, "ppo", *tiny, *more) == 0
    trained = tmp_path / "p" / "selector.safetensors"
    load_selector(str(trained))
    kept = tmp_path / "e"
    common = (*FEW, "--perception", "oracle", "--seed", "31", "--bins", "1", "--out", kept)
    assert call(evaluate_selector, *common, "--selectors", "weighted", trained, "hindsight") == 0
    shown = capsys.readouterr().out
    assert "best heuristic" in shown
    assert "hindsight (bound)" in shown
    numbers = json.loads((kept / "selectors.json").read_text())
    assert len(numbers["selectors"]) == 3
    assert numbers["best_heuristic"] == "weighted"


def _evaluation(arguments: list[str]) -> evaluate_selector.Arguments:
    return parse(evaluate_selector.Arguments, "evaluate-selector", arguments)


def _training(arguments: list[str]) -> train_selector.Arguments:
    return parse(train_selector.Arguments, "train-selector", arguments)


def test_what_makes_bins_hard_arrives() -> None:
    size = ["--bin", "0.3", "0.2", "0.15"]
    assert _evaluation(size).config().bin == (0.3, 0.2, 0.15)
    assert _evaluation([]).config().bin is None
    hard = ["--hand-eye", "0.01", "--sensor", "harsh"]
    config = _evaluation(hard).config()
    assert (config.camera.hand_eye, config.sensor) == (0.01, "harsh")
    for method in ("ppo", "bandit"):
        cells = _training([method, "--hand-eye-mm", "10", "--sensor", "harsh"]).cells()
        assert (cells.hand_eye_mm, cells.sensor) == (10.0, "harsh")
        assert _training([method, *size]).cells().bin == (0.3, 0.2, 0.15)
        assert _training([method]).cells().bin is None


def test_mistakes_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(evaluate_selector, "--perception", "oracle", "--selectors", "oracle", "--out", tmp_path) == 2
    assert "error: a selector must be one of random" in capsys.readouterr().err
    assert call(evaluate_selector, "--bin", "0.3", "0", "0.1") == 2
    assert "error: inner_size must be positive, got (0.3, 0.0, 0.1)" in capsys.readouterr().err
    assert call(evaluate_selector, "--perception", "oracle", "--bins", "0") == 2
    assert "error: bins and workers must be at least 1" in capsys.readouterr().err
    assert call(train_selector, "bandit", "--epsilon", "2", "--out", tmp_path) == 2
    assert "error: epsilon must be in [0, 1]" in capsys.readouterr().err
    assert call(train_selector, "ppo", "--rollout", "0", "--out", tmp_path) == 2
    assert "error: n_steps must be at least 1" in capsys.readouterr().err
