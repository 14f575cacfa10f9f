"""The bandit on a toy where the answer is known, and on attempts made by hand; once, briefly, in the cell."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from policies.selection.features import FEATURES, column
from policies.selection.learning.bandit import BanditConfig, Epoch, fit_bandit, ranking
from policies.selection.learning.bandit_run import train_bandit
from policies.selection.learning.experience import AttemptLog, Attempts, Behaviour, Cells, ExperienceError
from policies.selection.learning.ppo import PpoConfig, train_ppo
from policies.selection.network import SelectorNetConfig
from policies.selection.selectors import LearnedSelector, RandomSelector
from policies.selection.weights import load_selector_record
from tests.policies.selection.learning.toy_selection import PARTS, SMALL_NET, attempt_log, success


def files(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("*.npz")}


@pytest.mark.slow
def test_a_bandit_finds_what_delivers(tmp_path: Path, toys: None) -> None:
    config = BanditConfig(network=SelectorNetConfig(hidden=0), epochs=40, learning_rate=0.05, batch_size=64)
    seen: list[int] = []
    path, last = train_bandit(config, attempt_log(tmp_path, Behaviour(epsilon=1.0)), 60, on_bin=seen.append)
    assert seen == list(range(60))
    assert last.held_out < last.base
    assert last.auc > 0.85
    assert success(LearnedSelector(path)) > success(RandomSelector()) + 0.2
    record = load_selector_record(path)
    assert (record["method"], record["attempts"], record["bins"]) == ("bandit", 60 * PARTS, 60)
    assert list((tmp_path / "tensorboard").iterdir())


def test_logged_bins_stay_and_more_may_follow(tmp_path: Path, toys: None) -> None:
    config = BanditConfig(network=SMALL_NET, epochs=1)
    train_bandit(config, attempt_log(tmp_path), 3)
    before = files(tmp_path)
    train_bandit(config, attempt_log(tmp_path), 5)
    after = files(tmp_path)
    assert len(after) == 5
    assert all(after[name] == at for name, at in before.items())
    with pytest.raises(ExperienceError, match="holds attempts in other bins"):
        train_bandit(config, attempt_log(tmp_path, seed=1), 5)


def test_the_same_seed_logs_the_same_and_fits_the_same(tmp_path: Path, toys: None) -> None:
    nets = []
    for name in ("a", "b"):
        log = attempt_log(tmp_path / name, seed=7)
        list(log.fill(range(4)))
        nets.append(fit_bandit(log.attempts(range(4)), BanditConfig(network=SMALL_NET, epochs=3), seed=2))
    for one, other in zip(nets[0].parameters(), nets[1].parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0)


def test_choices_are_judged_within_their_states() -> None:
    """Four attempts from two states: all pairs but those within are in order."""
    grasps = np.zeros((4, 2, len(FEATURES)), np.float32)
    grasps[:, 0, column("quality")] = [0.9, 1.0, 0.1, 0.2]
    attempts = Attempts(
        grasps=grasps,
        mask=np.ones((4, 2), np.int8),
        chosen=np.zeros(4, np.int64),
        delivered=np.array([True, False, True, False]),
        bins=np.zeros(4, np.int64),
        states=np.array([0, 0, 1, 1]),
    )
    logits = grasps[:, 0, column("quality")].astype(float)
    assert ranking(logits, attempts, np.arange(4)) == (0.25, 0.0)
    alone = replace(attempts, states=np.arange(4))
    auc, within = ranking(logits, alone, np.arange(4))
    assert auc == 0.25
    assert np.isnan(within)


def confounded(states: int = 40) -> Attempts:
    """Four attempts a state: in easy bins all grasps are high, but in every state a low one delivers sooner."""
    rng = np.random.default_rng(0)
    easy = rng.random((states, 1)) < 0.5
    own = rng.random((states, 4))
    grasps = np.zeros((states, 4, len(FEATURES)), np.float32)
    grasps[:, :, column("z")] = 0.5 * easy + 0.4 * own
    return Attempts(
        grasps=np.repeat(grasps, 4, axis=0),
        mask=np.ones((4 * states, 4), np.int8),
        chosen=np.tile(np.arange(4), states),
        delivered=(own < np.where(easy, 0.9, 0.1)).ravel(),
        bins=np.repeat(np.arange(states), 4) // 2,
        states=np.repeat(np.arange(states), 4) % 2,
    )


def test_choices_are_learned_whatever_the_bin() -> None:
    weights = {}
    for loss in ("delivery", "choice"):
        config = BanditConfig(
            loss=loss, network=SelectorNetConfig(hidden=0, features=("z",)), learning_rate=0.05, epochs=60
        )
        epochs: list[Epoch] = []
        network = fit_bandit(confounded(), config, 0, epochs.append)
        weights[loss] = network.score.weight.item()  # type: ignore[operator, union-attr]
        assert epochs[-1].loss < epochs[0].loss
        assert epochs[-1].held_out < epochs[-1].base
    assert weights["delivery"] > 0 > weights["choice"]
    assert epochs[-1].base == pytest.approx(np.log(2))
    assert epochs[-1].within == 1.0


def test_a_choice_needs_something_to_choose_between() -> None:
    attempts = confounded()
    config = BanditConfig(loss="choice", network=SMALL_NET)
    with pytest.raises(ValueError, match="log several tries from each"):
        fit_bandit(replace(attempts, states=np.arange(len(attempts))), config, 0)


def test_a_bandit_that_chooses_finds_what_delivers(tmp_path: Path, toys: None) -> None:
    network = SelectorNetConfig(hidden=0, features=("quality", "top"))
    config = BanditConfig(loss="choice", network=network, epochs=40, learning_rate=0.05, batch_size=64)
    path, last = train_bandit(config, attempt_log(tmp_path, Behaviour(tries=3)), 40)
    assert last.within > 0.85
    assert success(LearnedSelector(path)) > success(RandomSelector()) + 0.2


def test_an_epoch_says_how_well_it_does() -> None:
    text = str(Epoch(epoch=3, loss=0.5, held_out=0.4, base=0.6, auc=0.75, within=0.65))
    assert text == "cross-entropy 0.400 (to beat: 0.600), AUC 0.750 (within states 0.650)"


@pytest.mark.parametrize(
    ("unknown", "text"),
    [
        (("held_out", "auc", "within"), "too few attempts to judge; log more bins"),
        (
            ("auc", "within"),
            "(to beat: 0.600); too few attempts for an AUC, which needs a delivered and a failed one",
        ),
        (("within",), "AUC 0.750 (within states unknown: too few attempts)"),
    ],
)
def test_too_few_attempts_are_said_and_no_nan(unknown: tuple[str, ...], text: str) -> None:
    known = {"held_out": 0.4, "base": 0.6, "auc": 0.75, "within": 0.65}
    said = str(Epoch(epoch=3, loss=0.5, **known | dict.fromkeys(unknown, np.nan)))
    assert said.endswith(text)
    assert "nan" not in said


@pytest.mark.slow
def test_both_train_in_the_cell(tmp_path: Path) -> None:
    cells = Cells(min_parts=1, max_parts=2, fast=True, width=640, height=480)
    log = AttemptLog(folder=tmp_path / "bandit", cells=cells, behaviour=Behaviour(), seed=31)
    path, _ = train_bandit(BanditConfig(network=SMALL_NET, epochs=2), log, 2)
    train_ppo(PpoConfig(n_steps=2, batch_size=2, n_epochs=1), cells, tmp_path / "ppo", 2, initial=path)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"loss": "x"}, "loss must be one of delivery, choice, got 'x'"),
        ({"epochs": 0}, "epochs and batch_size must be at least 1, got 0 and 256"),
        ({"learning_rate": 0}, "learning_rate must be positive and weight_decay not negative, got 0"),
        ({"held_out": 1}, r"held_out must be in \[0, 1\), got 1"),
    ],
)
def test_nonsense_is_refused(change: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        BanditConfig(**change)
