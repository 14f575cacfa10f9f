"""MaskablePPO on a toy where the answer is known: what it learns, resumes and records."""

import json
import sys
import zipfile
from base64 import b64decode
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch

from policies.selection.learning.bandit import BanditConfig
from policies.selection.learning.bandit_run import train_bandit
from policies.selection.learning.experience import Cells
from policies.selection.learning.policy import SelectorPolicy
from policies.selection.learning.ppo import CHECKPOINT, CONFIG, PpoConfig, TrainingError, train_ppo
from policies.selection.learning.record_keys import PPO_KEYS
from policies.selection.network import SelectorNet, SelectorNetConfig
from policies.selection.selectors import LearnedSelector, RandomSelector
from policies.selection.weights import load_selector_record, save_selector
from tests.policies.selection.learning.toy_selection import CELLS, SMALL_NET, attempt_log, success, toy

TINY = PpoConfig(network=SMALL_NET, n_steps=32, batch_size=16)


@pytest.mark.slow
def test_ppo_finds_what_delivers(tmp_path: Path, toys: None) -> None:
    config = PpoConfig(network=SMALL_NET, n_steps=256, batch_size=64, learning_rate=3e-3, ent_coef=0.0, gamma=0.0)
    progress: list[int] = []
    path = train_ppo(config, CELLS, tmp_path, 2000, on_progress=lambda picks, rates: progress.append(picks))
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


def test_ppo_resumes_from_its_checkpoint_in_other_cells(tmp_path: Path, toys: None) -> None:
    path = train_ppo(TINY, CELLS, tmp_path, 64)
    before = path.read_bytes()
    assert train_ppo(TINY, CELLS, tmp_path, 64) == path  # nothing is left to do
    assert load_selector_record(path)["picks"] == 64
    train_ppo(TINY, replace(CELLS, perception="learned"), tmp_path, 96)
    record = load_selector_record(path)
    assert record["picks"] == 96
    assert [cells["perception"] for cells in record["cells"]] == ["oracle", "learned"]
    assert path.read_bytes() != before
    with pytest.raises(TrainingError, match="holds a training of another configuration"):
        train_ppo(replace(TINY, learning_rate=1e-4), CELLS, tmp_path, 96)


def test_a_training_of_an_older_version_is_resumed(tmp_path: Path, toys: None) -> None:
    """Its settings have their former names, and it does not tell its number of environments."""
    path = train_ppo(TINY, CELLS, tmp_path, 32)
    noted = json.loads((tmp_path / CONFIG).read_text())
    older = {name: value for name, value in noted["ppo"].items() if name not in (*PPO_KEYS, "n_envs")}
    assert set(older) == {"network", "rollout", "batch", "epochs", "rate", "discount", "entropy", "seed"}
    (tmp_path / CONFIG).write_text(json.dumps({"ppo": older, "cells": noted["cells"]}))
    train_ppo(TINY, CELLS, tmp_path, 64)
    assert load_selector_record(path)["picks"] == 64
    assert json.loads((tmp_path / CONFIG).read_text()) == noted
    (tmp_path / CONFIG).write_text(json.dumps({"ppo": {**older, "discount": 0.5}, "cells": noted["cells"]}))
    with pytest.raises(TrainingError, match="holds a training of another configuration"):
        train_ppo(TINY, CELLS, tmp_path, 64)


def test_a_checkpoint_that_names_former_modules_is_resumed(tmp_path: Path, toys: None, monkeypatch: Any) -> None:
    """Checkpoints of version 0.1.0 hold classes of `policies.selector_policy` and `policies.selector_net`."""
    for former, kept in (("selector_policy", SelectorPolicy), ("selector_net", SelectorNetConfig)):
        module = ModuleType(f"policies.{former}")
        setattr(module, kept.__name__, kept)
        monkeypatch.setitem(sys.modules, module.__name__, module)
        monkeypatch.setattr(kept, "__module__", module.__name__)
    path = train_ppo(TINY, CELLS, tmp_path, 32)
    monkeypatch.undo()
    monkeypatch.setattr(Cells, "environment", toy)
    with zipfile.ZipFile(tmp_path / CHECKPOINT) as file:
        stored = json.loads(file.read("data"))
    assert b"policies.selector_policy" in b64decode(stored["policy_class"][":serialized:"])
    assert b"policies.selector_net" in b64decode(stored["policy_kwargs"][":serialized:"])
    train_ppo(TINY, CELLS, tmp_path, 64)
    assert load_selector_record(path)["picks"] == 64
    assert "policies.selector_policy" not in sys.modules


def test_the_number_of_environments_may_change(tmp_path: Path, toys: None, monkeypatch: pytest.MonkeyPatch) -> None:
    from stable_baselines3.common.vec_env import DummyVecEnv

    monkeypatch.setattr("policies.selection.learning.ppo.SubprocVecEnv", lambda makers, **_: DummyVecEnv(makers))
    path = train_ppo(TINY, CELLS, tmp_path, 32)
    train_ppo(replace(TINY, n_envs=2), CELLS, tmp_path, 96)
    record = load_selector_record(path)
    assert (record["picks"], record["ppo"]["n_envs"]) == (96, 2)


def test_settings_are_recorded_under_present_and_former_names() -> None:
    record = PpoConfig(learning_rate=1e-4).record()
    assert (record["learning_rate"], record["n_steps"]) == (1e-4, 128)
    assert all(record[former] == record[present] for present, former in PPO_KEYS.items())
    bandit = BanditConfig(learning_rate=1e-4).record()
    assert [bandit[name] for name in ("learning_rate", "rate", "batch", "decay")] == [1e-4, 1e-4, 256, 1e-2]


def test_ppo_starts_from_a_bandit(tmp_path: Path, toys: None) -> None:
    """Without a pick made, the result is what it started from."""
    config = BanditConfig(network=SMALL_NET, epochs=1)
    start, _ = train_bandit(config, attempt_log(tmp_path / "bandit"), 3)
    path = train_ppo(PpoConfig(n_steps=8, batch_size=8), CELLS, tmp_path / "ppo", 0, initial=start)
    selectors = [LearnedSelector(each)._network.state_dict() for each in (start, path)]
    assert selectors[0].keys() == selectors[1].keys()
    assert all(torch.equal(selectors[0][name], selectors[1][name]) for name in selectors[0])


def test_the_network_of_the_initial_selector_is_recorded(tmp_path: Path, toys: None) -> None:
    """It is the one that is trained, whatever network the configuration asks for; the training can be resumed."""
    small = SelectorNetConfig(features=("top", "quality"), hidden=8)
    start, out = tmp_path / "start.safetensors", tmp_path / "ppo"
    save_selector(start, SelectorNet(small), {})
    path = train_ppo(TINY, CELLS, out, 0, initial=start)
    train_ppo(TINY, CELLS, out, 32, initial=start)
    train_ppo(TINY, CELLS, out, 64)
    record = load_selector_record(path)
    assert record["picks"] == 64
    assert (
        record["ppo"]["network"]
        == record["network"]
        == {"features": list(small.features), "hidden": 8, "context": True}
    )
    assert json.loads((out / CONFIG).read_text())["ppo"]["network"] == record["network"]
    with pytest.raises(TrainingError, match="holds a training of another configuration"):
        train_ppo(replace(TINY, network=SelectorNetConfig(hidden=4)), CELLS, out, 64, initial=start)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"n_steps": 0}, "n_steps must be at least 1, got 0"),
        ({"n_envs": 0}, "n_envs must be at least 1, got 0"),
        ({"gamma": 2}, r"gamma in \[0, 1\], ent_coef not negative, got 0.0003, 2"),
    ],
)
def test_nonsense_is_refused(change: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        PpoConfig(**change)
