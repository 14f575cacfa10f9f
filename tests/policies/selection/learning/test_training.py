"""Both ways to train a selector, on a toy where the answer is known; once, briefly, in the cell."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from policies.selection.features import FEATURES, column
from policies.selection.learning.bandit import BanditConfig, Epoch, fit_bandit, ranking
from policies.selection.learning.bandit_run import ExperienceError, train_bandit
from policies.selection.learning.experience import Attempts, Behaviour, Cells, bin_file, gather
from policies.selection.learning.ppo import PpoConfig, TrainingError, train_ppo
from policies.selection.network import SelectorNetConfig
from policies.selection.selectors import LearnedSelector, RandomSelector, Selector
from policies.selection.weights import load_selector_record
from tests.policies.selection.learning.toy_selection import PARTS, ToySelection, toy

CELLS = Cells(part="toy")
SMALL_NET = SelectorNetConfig(hidden=16)


@pytest.fixture
def toys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("policies.selection.learning.experience._environments", {})
    monkeypatch.setattr(Cells, "environment", toy)


def success(selector: Selector, bins: int = 30) -> float:
    env, rng, won = ToySelection(), np.random.default_rng(0), 0
    for seed in range(bins):
        observation, over = env.reset(seed=1000 + seed)[0], False
        while not over:
            observation, _, over, _, _ = env.step(np.int64(selector.select(observation, rng)))
            won += env.result.success
    return won / (bins * PARTS)


def files(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("*.npz")}


def test_a_bandit_finds_what_delivers(tmp_path: Path, toys: None) -> None:
    config = BanditConfig(network=SelectorNetConfig(hidden=0), epochs=40, rate=0.05, batch=64)
    seen: list[int] = []
    path, last = train_bandit(config, CELLS, Behaviour(epsilon=1.0), tmp_path, 60, seed=0, on_bin=seen.append)
    assert seen == list(range(60))
    assert last.held_out < last.base
    assert last.auc > 0.85
    assert success(LearnedSelector(path)) > success(RandomSelector()) + 0.2
    record = load_selector_record(path)
    assert (record["method"], record["attempts"], record["bins"]) == ("bandit", 60 * PARTS, 60)
    assert list((tmp_path / "tensorboard").iterdir())


def test_logged_bins_stay_and_more_may_follow(tmp_path: Path, toys: None) -> None:
    config = BanditConfig(network=SMALL_NET, epochs=1)
    train_bandit(config, CELLS, Behaviour(), tmp_path, 3, seed=0)
    before = files(tmp_path)
    train_bandit(config, CELLS, Behaviour(), tmp_path, 5, seed=0)
    after = files(tmp_path)
    assert len(after) == 5
    assert all(after[name] == at for name, at in before.items())
    with pytest.raises(ExperienceError, match="holds attempts in other bins"):
        train_bandit(config, CELLS, Behaviour(), tmp_path, 5, seed=1)


def test_the_same_seed_logs_the_same_and_fits_the_same(tmp_path: Path, toys: None) -> None:
    nets = []
    for name in ("a", "b"):
        list(gather(CELLS, Behaviour(), tmp_path / name, range(4), 7))
        attempts = Attempts.load([bin_file(tmp_path / name, k) for k in range(4)])
        nets.append(fit_bandit(attempts, BanditConfig(network=SMALL_NET, epochs=3), seed=2))
    for one, other in zip(nets[0].parameters(), nets[1].parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0)


def test_epsilon_mixes_in_random_choices(tmp_path: Path, toys: None) -> None:
    for epsilon, low, high in ((0.0, 1.0, 1.0), (1.0, 0.2, 0.75)):
        out = tmp_path / str(epsilon)
        list(gather(CELLS, Behaviour(selector="highest", epsilon=epsilon), out, range(30), 0))
        attempts = Attempts.load([bin_file(out, k) for k in range(30)])
        assert len(attempts) == 30 * PARTS
        tops = np.where(attempts.mask > 0, attempts.grasps[:, :, column("top")], -1)
        assert low <= np.mean(tops.argmax(axis=1) == attempts.chosen) <= high
        assert set(attempts.bins) == set(range(30))
        quality = attempts.grasps[np.arange(len(attempts)), attempts.chosen, column("quality")]
        np.testing.assert_array_equal(attempts.delivered, quality > 0.5)


def test_several_grasps_are_tried_from_each_state(tmp_path: Path, toys: None) -> None:
    list(gather(CELLS, Behaviour(tries=3), tmp_path, range(4), 0))
    attempts = Attempts.load([bin_file(tmp_path, k) for k in range(4)])
    quality = attempts.grasps[np.arange(len(attempts)), attempts.chosen, column("quality")]
    np.testing.assert_array_equal(attempts.delivered, quality > 0.5)
    counts = []
    for k in range(4):
        for state in range(PARTS):
            own = (attempts.bins == k) & (attempts.states == state)
            assert len({row.tobytes() for row in attempts.grasps[own]}) == 1
            assert len(set(attempts.chosen[own])) == own.sum() == min(3, attempts.mask[own][0].sum())
            counts.append(own.sum())
    assert set(counts) == {1, 2, 3}
    assert sum(counts) == len(attempts)


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
        config = BanditConfig(loss=loss, network=SelectorNetConfig(hidden=0, features=("z",)), rate=0.05, epochs=60)
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
    config = BanditConfig(loss="choice", network=network, epochs=40, rate=0.05, batch=64)
    path, last = train_bandit(config, CELLS, Behaviour(tries=3), tmp_path, 40, seed=0)
    assert last.within > 0.85
    assert success(LearnedSelector(path)) > success(RandomSelector()) + 0.2


def test_bins_without_attempts_cannot_be_learned_from(tmp_path: Path, toys: None) -> None:
    list(gather(CELLS, Behaviour(), tmp_path, range(1), 0))
    with np.load(bin_file(tmp_path, 0)) as file:
        empty = {name: file[name][:0] for name in file.files}
    np.savez(bin_file(tmp_path, 1), **empty)
    with pytest.raises(ValueError, match="1 bins hold no attempt"):
        Attempts.load([bin_file(tmp_path, 1)])


def test_ppo_finds_what_delivers(tmp_path: Path, toys: None) -> None:
    config = PpoConfig(network=SMALL_NET, rollout=256, batch=64, rate=3e-3, entropy=0.0, discount=0.0)
    progress: list[int] = []
    path = train_ppo(config, CELLS, tmp_path, 4000, on_progress=lambda picks, rates: progress.append(picks))
    assert progress[0] == 256
    assert success(LearnedSelector(path)) > success(RandomSelector()) + 0.2
    record = load_selector_record(path)
    assert record["method"] == "MaskablePPO"
    assert record["picks"] == progress[-1]
    assert 0.5 < record["rates"]["dr"] <= 1.0
    events = list((tmp_path / "tensorboard").rglob("events*"))
    assert events
    assert b"selector/dr" in events[0].read_bytes()
    assert b"rollout/success_rate" in events[0].read_bytes()


def test_ppo_goes_on_from_its_checkpoint_in_other_cells(tmp_path: Path, toys: None) -> None:
    config = PpoConfig(network=SMALL_NET, rollout=32, batch=16)
    path = train_ppo(config, CELLS, tmp_path, 64)
    before = path.read_bytes()
    assert train_ppo(config, CELLS, tmp_path, 64) == path  # nothing is left to do
    assert load_selector_record(path)["picks"] == 64
    train_ppo(config, replace(CELLS, perception="learned"), tmp_path, 96)
    record = load_selector_record(path)
    assert record["picks"] == 96
    assert [cells["perception"] for cells in record["cells"]] == ["oracle", "learned"]
    assert path.read_bytes() != before
    with pytest.raises(TrainingError, match="holds a training of another configuration"):
        train_ppo(replace(config, rate=1e-4), CELLS, tmp_path, 96)


def test_ppo_starts_from_a_bandit(tmp_path: Path, toys: None) -> None:
    """Without a pick made, the result is what it started from."""
    config = BanditConfig(network=SMALL_NET, epochs=1)
    start, _ = train_bandit(config, CELLS, Behaviour(), tmp_path / "bandit", 3, seed=0)
    path = train_ppo(PpoConfig(rollout=8, batch=8), CELLS, tmp_path / "ppo", 0, initial=start)
    selectors = [LearnedSelector(each)._network.state_dict() for each in (start, path)]
    assert selectors[0].keys() == selectors[1].keys()
    assert all(torch.equal(selectors[0][name], selectors[1][name]) for name in selectors[0])


@pytest.mark.slow
def test_both_train_in_the_cell(tmp_path: Path) -> None:
    cells = Cells(min_parts=2, max_parts=3, fast=True)
    path, _ = train_bandit(
        BanditConfig(network=SMALL_NET, epochs=2), cells, Behaviour(), tmp_path / "bandit", 2, seed=31
    )
    train_ppo(PpoConfig(rollout=4, batch=4, epochs=1), cells, tmp_path / "ppo", 4, initial=path)


def test_cells_may_have_another_bin() -> None:
    env = Cells(min_parts=1, max_parts=2, bin=(0.3, 0.2, 0.1)).environment()
    assert env.cell.workspace.inner_size.tolist() == [0.3, 0.2, 0.1]
    env.close()


def test_cells_are_noted_as_json_gives_them_back() -> None:
    plain = Cells(part="toy", bin=(0.3, 0.2, 0.1)).plain()
    assert set(plain) == {field.name for field in fields(Cells)}
    assert plain["bin"] == [0.3, 0.2, 0.1]


def test_cells_may_see_worse() -> None:
    env = Cells(min_parts=1, max_parts=2, hand_eye=0.01).environment()
    assert env.cell.config.camera.hand_eye == 0.01
    env.close()


def test_an_epoch_says_how_well_it_does() -> None:
    text = str(Epoch(epoch=3, loss=0.5, held_out=0.4, base=0.6, auc=0.75, within=0.65))
    assert text == "cross-entropy 0.400 (to beat: 0.600), AUC 0.750 (within states 0.650)"


@pytest.mark.parametrize(
    ("build", "text"),
    [
        (lambda: Behaviour(epsilon=1.5), r"epsilon must be in \[0, 1\], got 1.5"),
        (lambda: Behaviour(tries=0), "tries must be at least 1, got 0"),
        (lambda: BanditConfig(loss="x"), "loss must be one of delivery, choice, got 'x'"),  # type: ignore[arg-type]
        (lambda: BanditConfig(epochs=0), "epochs and batch must be at least 1, got 0 and 256"),
        (lambda: BanditConfig(rate=0), "rate must be positive and decay not negative, got 0"),
        (lambda: BanditConfig(held_out=1), r"held_out must be in \[0, 1\), got 1"),
        (lambda: PpoConfig(rollout=0), "rollout must be at least 1, got 0"),
        (lambda: PpoConfig(discount=2), r"discount in \[0, 1\], entropy not negative, got 0.0003, 2"),
    ],
)
def test_nonsense_is_refused(build: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        build()
