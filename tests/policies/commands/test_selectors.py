"""`binpick fit-noise`, `check-fast`, `train-selector` and `evaluate-selector`, each from its command line."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from binpick_env.evaluation import noise
from binpick_env.evaluation.noise import NoiseBins, ObservedBin
from binpick_env.observation.perception_noise import GeneralNoise, PerceptionNoise
from binpick_env.options import CellOptions
from policies.commands import check_fast, evaluate_selector, fit_noise, train_selector
from policies.commands.command_line import parse
from policies.evaluation.config import EvaluationConfig
from policies.grasping.outcomes import GraspOutcome
from policies.selection import env, fast_agreement
from policies.selection.fast_agreement import PairedAttempt
from policies.selection.selectors import load_selector
from tests.binpick_env.evaluation.noise.observed_bins import drawn_bins, observed, row

FEW = ("--min-parts", "2", "--max-parts", "3")


def call(command: ModuleType, *arguments: object) -> int:
    return int(command.main([str(argument) for argument in arguments]))


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Replace the observation of bins by those in "bins"; return what was asked for."""
    asked: dict[str, Any] = {}

    def observe(config: NoiseBins, count: int, folder: Path, workers: int) -> Iterator[int]:
        asked.update(config=config, count=count, folder=folder, workers=workers)
        return iter(range(count))

    monkeypatch.setattr(noise, "observe_bins", observe)
    monkeypatch.setattr(noise, "load_bins", lambda *_: asked["bins"])
    weights = {"path": "/somewhere/weights.safetensors", "sha256": "abc"}
    monkeypatch.setattr(NoiseBins, "weights", lambda _: weights)
    return asked


def test_a_noise_model_is_fitted_and_kept(
    tmp_path: Path, asked: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "tee_harsh.json"
    asked["bins"] = [observed("tee", "flat", [row(0.95), row(0.95, found=False)])] * 5
    assert call(fit_noise, "--part", "tee", "--bins", 5, "--seed", 31, "--sensor", "harsh", "--json", out) == 0
    config = NoiseBins(options=CellOptions(part="tee", sensor="harsh"), seed=31, num_parts=(2, 30))
    folder = Path("runs/fit-noise-tee-harsh-31")
    assert (asked["config"], asked["count"], asked["folder"], asked["workers"]) == (config, 5, folder, 1)
    fitted = PerceptionNoise.load(out)
    assert (fitted.bins[-1].offered, fitted.bins[-1].count) == (0.5, 10)
    assert {"command", "commit", "seed", "bins"} <= fitted.provenance.keys()
    assert fitted.provenance["weights"] == {"name": "weights.safetensors", "sha256": "abc"}
    assert fitted.provenance["shape"] == list(asked["bins"][0].signature)
    assert "50.0 %" in capsys.readouterr().out
    asked["bins"] = [observed("tee", "flat", [])]
    assert call(fit_noise, "--json", out) == 2
    assert "hold no correct pose" in capsys.readouterr().err


def test_a_noise_model_for_every_part_is_fitted_checked_and_kept(
    tmp_path: Path, asked: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "general_good.json"
    restless: ObservedBin = replace(observed("generated:spool:1000", "compact", []), frame=None)
    flat = drawn_bins("flat", 6, np.random.default_rng(0), offered=0.5, wrong=0.2)
    asked["bins"] = [*flat, restless]
    assert call(fit_noise, "--part", "generated", "--bins", 19, "--json", out) == 0
    assert asked["config"].many
    record = GeneralNoise.load(out).provenance
    assert record["parts"] == {**{f"flat-{k}": "medium flat" for k in range(6)}, restless.part: "medium compact"}
    assert record["training"] == {"zero-shot": 7}
    assert [each["shape"] for each in record["check"]] == ["flat", "all"]
    shown = capsys.readouterr().out
    assert "rates on parts left out of the fit: observed / drawn" in shown
    assert re.search(r"\nflat +6 +360 +\d+\.\d / +\d+\.\d ", shown)
    assert f"fitted to 7 parts; kept in {out}" in shown
    assert shown.endswith("bins left out, whose pile did not come to rest: 1\n")


def test_fast_and_full_are_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made: list[dict[str, Any]] = []
    monkeypatch.setattr(env, "GraspSelectionEnv", lambda **settings: made.append(settings))
    pair = PairedAttempt(full=GraspOutcome.DELIVERED, fast=GraspOutcome.DELIVERED, seconds=(2.0, 1.0), shift=0.0)
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
def test_a_selector_is_trained_on_all_bins_and_further_by_ppo(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny = (*FEW, "--fast", "--seed", "31")
    bandit = ("bandit", *tiny, "--bins", "2", "--out", tmp_path / "b")
    assert call(train_selector, *bandit, "--held-out", "0") == 0
    assert "on all bins, fitted: cross-entropy" in capsys.readouterr().out
    start = tmp_path / "b" / "selector.safetensors"
    more = ("--picks", "4", "--rollout", "4", "--initial", start, "--out", tmp_path / "p")
    assert call(train_selector, "ppo", *tiny, *more) == 0
    load_selector(str(tmp_path / "p" / "selector.safetensors"))


def test_selectors_that_cannot_be_compared_are_refused_before_a_bin_is_picked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(EvaluationConfig, "check", lambda self: pytest.fail("the cell is being built"))
    assert call(evaluate_selector, "--selectors", "hindsight", "--out", tmp_path / "runs") == 2
    assert "error: a heuristic is needed to compare with: one of random" in capsys.readouterr().err
    assert call(evaluate_selector, "--selectors", "weighted", "nobody", "--out", tmp_path / "runs") == 2
    assert "error: a selector must be one of random" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def _evaluation(arguments: list[str]) -> evaluate_selector.Arguments:
    return parse(evaluate_selector.Arguments, "evaluate-selector", arguments)


def _training(arguments: list[str]) -> train_selector.Arguments:
    return parse(train_selector.Arguments, "train-selector", arguments)


def test_what_makes_bins_hard_arrives(capsys: pytest.CaptureFixture[str]) -> None:
    for size in (["--bin", "0.3", "0.2", "0.15"], ["--bin", "300x200x150"], ["--bin=300x200x150"]):
        assert _evaluation(size).config().bin == (0.3, 0.2, 0.15)
        for method in ("ppo", "bandit"):
            assert _training([method, *size]).cells().bin == (0.3, 0.2, 0.15)
    assert _evaluation([]).config().bin is None
    assert _training(["ppo"]).cells().bin is None
    hard = ["--hand-eye-mm", "10", "--sensor", "harsh", "--jaw", "0.07", "--friction", "0.3", "--max-jerk", "50"]
    config = _evaluation(hard).config()
    assert (config.camera.hand_eye, config.sensor, config.jaw, config.friction) == (0.01, "harsh", 0.07, 0.3)
    assert config.max_jerk == 50.0
    for method in ("ppo", "bandit"):
        cells = _training([method, *hard]).cells()
        assert (cells.hand_eye_mm, cells.sensor, cells.jaw, cells.friction) == (10.0, "harsh", 0.07, 0.3)
        assert cells.max_jerk == 50.0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("given", [["--hand-eye", "0.01"], ["--hand_eye", "0.01"], ["--hand-eye=0.01"]])
def test_the_previous_name_of_an_option_is_taken_with_a_note(
    given: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert _evaluation(given).config().camera.hand_eye == 0.01
    assert _training(["bandit", *given]).cells().hand_eye_mm == 10.0
    note = "note: --hand-eye (in metres) is now --hand-eye-mm (in millimetres)\n"
    assert capsys.readouterr().err == 2 * note
    for broken in (["--hand-eye", "far"], ["--hand-eye"]):
        with pytest.raises(SystemExit, match="2"):
            _evaluation(broken)


def test_the_options_of_the_cell_are_all_there() -> None:
    assert train_selector.Bandit().options() == CellOptions()
    assert CellOptions.__dataclass_fields__.keys() <= check_fast.Arguments.__dataclass_fields__.keys()


def test_mistakes_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(evaluate_selector, "--perception", "oracle", "--selectors", "oracle", "--out", tmp_path) == 2
    assert "error: a selector must be one of random" in capsys.readouterr().err
    assert call(evaluate_selector, "--bin", "0.3", "0", "0.1") == 2
    error = "error: bin must be length, width and height inside [m], all positive, got (0.3, 0.0, 0.1)"
    assert error in capsys.readouterr().err
    assert call(evaluate_selector, "--perception", "oracle", "--bins", "0") == 2
    assert "error: bins and workers must be at least 1" in capsys.readouterr().err
    assert call(train_selector, "bandit", "--epsilon", "2", "--out", tmp_path) == 2
    assert "error: epsilon must be in [0, 1]" in capsys.readouterr().err
    assert call(train_selector, "ppo", "--rollout", "0", "--out", tmp_path) == 2
    assert "error: n_steps must be at least 1" in capsys.readouterr().err
