"""MaskablePPO on `BinPickSelect-v0` with checkpoints and TensorBoard; the result is a selector."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from binpick_env.jobs.workers import Cluster
from perception.runtime.files import json_text, replace_atomically, write_atomically
from perception.runtime.provenance import command_line, git_commit, versions
from perception.runtime.threads import one_core
from policies.grasping.outcomes import Abstention, GraspOutcome
from policies.selection.env import ABSTAINED
from policies.selection.learning.checkpoint import load_checkpoint
from policies.selection.learning.cluster_vec_env import Maker, environments_on_cluster
from policies.selection.learning.episodes import SeededEpisodes
from policies.selection.learning.experience import Cells
from policies.selection.learning.policy import SelectorPolicy
from policies.selection.learning.record_keys import PPO_KEYS, with_former_keys, without_former_keys
from policies.selection.network import SelectorNet, SelectorNetConfig
from policies.selection.weights import load_selector_net, save_selector

CHECKPOINT, WEIGHTS, CONFIG = "checkpoint.zip", "selector.safetensors", "config.json"
_NO_ATTEMPT = {"", ABSTAINED, *map(str, Abstention)}


@dataclass(frozen=True, kw_only=True)
class PpoConfig:
    """Hyperparameters under SB3's names; only ``n_envs`` and ``cluster`` may change when a training is resumed."""

    network: SelectorNetConfig = field(default_factory=SelectorNetConfig)
    n_envs: int = 1  # number of environments; several run in processes of their own
    cluster: Cluster | None = None  # where each environment runs in a process of its own; None: on this machine
    n_steps: int = 128  # picks per environment between updates
    batch_size: int = 64  # picks per gradient step
    n_epochs: int = 6  # passes over the picks of an update
    learning_rate: float = 3e-4  # step size of Adam
    gamma: float = 0.9  # discount factor: what a pick does to the pile shows within some ten picks
    ent_coef: float = 0.01  # weight of the policy's entropy in the loss
    seed: int = 0  # seed of initial weights, order of the picks and piles

    def __post_init__(self) -> None:
        for name in ("n_envs", "n_steps", "batch_size", "n_epochs"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if not (self.learning_rate > 0 and 0 <= self.gamma <= 1 and self.ent_coef >= 0):
            raise ValueError(
                f"learning_rate must be positive, gamma in [0, 1], ent_coef not negative, got {self.learning_rate}, "
                f"{self.gamma} and {self.ent_coef}"
            )

    def record(self) -> dict[str, Any]:
        """Return the settings as they are written to files, under their present and their former names.

        The cluster is left out, since results do not depend on it.
        """
        settings = asdict(self)
        settings.pop("cluster")
        values: dict[str, Any] = json.loads(json_text(with_former_keys(settings, PPO_KEYS)))
        return values


class TrainingError(ValueError):
    """The folder holds a training with another configuration."""


def train_ppo(
    config: PpoConfig,
    cells: Cells,
    out: Path,
    picks: int,
    *,
    initial: Path | None = None,
    on_progress: Callable[[int, dict[str, float]], None] | None = None,
) -> Path:
    """Train until ``picks`` picks have been made in all, starting from the folder's checkpoint if it holds one.

    The cells may change from one call to the next: the last stretch may use the learned perception. Piles and random
    numbers follow from the configuration's seed, the number of environments and the picks before this call, wherever
    the environments run. A training that was stopped and resumed therefore sees other piles than an uninterrupted one.

    Args:
        config: Network and hyperparameters.
        cells: Bins that are picked.
        out: Folder of checkpoint, weights, ``tensorboard`` and configuration.
        picks: Total number of picks, including those before the checkpoint; an update is always completed.
        initial: Selector to start from, which also determines the network instead of ``config``; random weights if
            None. A checkpoint takes precedence.
        on_progress: Callback with the picks so far and the rates in the last bins, called before each update.

    Returns:
        Path of the selector.

    Raises:
        TrainingError: The folder holds a training with another configuration.
        WorkerError: The cluster cannot go on; see
            :func:`policies.selection.learning.cluster_vec_env.environments_on_cluster`. The checkpoint remains valid.
    """
    stretches = _stretches(config, cells, out)
    with one_core():
        vector = _vector(cells, config)
        try:
            model = _model(config, vector, out, initial)
            trained = replace(config, network=network_of(model).config)
            noted = {"ppo": trained.record(), "requested_network": asdict(config.network), "cells": stretches}
            write_atomically(out / CONFIG, json_text(noted))
            keeper = _Keeper(out, on_progress)
            model.set_random_seed(_stretch_seed(config.seed, model.num_timesteps))
            model.learn(
                max(picks - model.num_timesteps, 0),
                callback=keeper,
                reset_num_timesteps=False,
                tb_log_name=f"stretch_{len(stretches)}",
            )
        finally:
            vector.close()
        record = {"method": "MaskablePPO", "ppo": trained.record(), "cells": stretches, "picks": model.num_timesteps}
        record |= {"rates": keeper.rates(), "command": command_line(), "commit": git_commit(), "versions": versions()}
        save_selector(out / WEIGHTS, network_of(model), record)
    return out / WEIGHTS


def network_of(model: MaskablePPO) -> SelectorNet:
    """Return the network that ``model`` trains."""
    policy = model.policy
    assert isinstance(policy, SelectorPolicy)
    return policy.network


class _Keeper(BaseCallback):
    """Logs the rates in the last bins, and saves a checkpoint after each update."""

    def __init__(self, out: Path, on_progress: Callable[[int, dict[str, float]], None] | None, bins: int = 50) -> None:
        super().__init__()
        self._out, self._on_progress, self._bins = out, on_progress, bins
        self._finished: list[tuple[int, int, bool]] = []  # delivered parts, all parts and success in the last bins
        self._outcomes: list[bool] = []  # whether each of the last attempts delivered

    def rates(self) -> dict[str, float]:
        """Return DR and success rate in the last bins, and GSR over about as many picks; NaN without any."""
        ended, tried = self._finished, self._outcomes
        return {
            "dr": sum(bin[0] for bin in ended) / sum(bin[1] for bin in ended) if ended else float("nan"),
            "gsr": sum(tried) / len(tried) if tried else float("nan"),
            "success_rate": sum(bin[2] for bin in ended) / len(ended) if ended else float("nan"),
        }

    def _on_step(self) -> bool:
        for info, done in zip(self.locals["infos"], self.locals["dones"], strict=True):
            if info["outcome"] not in _NO_ATTEMPT:
                self._outcomes.append(info["outcome"] == GraspOutcome.DELIVERED)
            if done:
                self._finished.append((info["delivered"], info["total"], info["is_success"]))
        del self._finished[: -self._bins], self._outcomes[: -20 * self._bins]
        return True

    def _on_rollout_end(self) -> None:
        for name, value in self.rates().items():
            if not np.isnan(value):
                self.logger.record(f"selector/{name}", value)
        if self._on_progress is not None:
            self._on_progress(self.num_timesteps, self.rates())

    def _on_rollout_start(self) -> None:
        self._save()  # includes the update after the last rollout

    def _on_training_end(self) -> None:
        self._save()

    def _save(self) -> None:
        def write(draft: Path) -> None:
            with draft.open("wb") as file:
                self.model.save(file)

        replace_atomically(self._out / CHECKPOINT, write)


def _vector(cells: Cells, config: PpoConfig) -> VecEnv:
    makers: list[Maker] = [partial(_environment, cells)] * config.n_envs
    if config.cluster is not None:
        return environments_on_cluster(makers, config.cluster)
    return DummyVecEnv(makers) if config.n_envs == 1 else SubprocVecEnv(makers, start_method="forkserver")


def _environment(cells: Cells) -> Monitor:
    cv2.setNumThreads(1)  # which processes do not take over from the one that starts them
    return Monitor(SeededEpisodes(cells.environment()))


def _stretch_seed(seed: int, picks: int) -> int:
    """Return the seed of a stretch that begins after some picks: a resumed one sees other piles.

    SB3 gives each environment this seed plus its index, as that of its series of episodes.
    """
    return int(np.random.SeedSequence([seed, picks]).generate_state(1)[0])


def _model(config: PpoConfig, vector: VecEnv, out: Path, initial: Path | None) -> MaskablePPO:
    if (out / CHECKPOINT).exists():
        return load_checkpoint(out / CHECKPOINT, vector, out / "tensorboard")
    network = config.network
    start = load_selector_net(initial) if initial is not None else None
    model = MaskablePPO(
        SelectorPolicy,
        vector,
        learning_rate=config.learning_rate,
        n_steps=config.n_steps,
        batch_size=config.batch_size,
        n_epochs=config.n_epochs,
        gamma=config.gamma,
        ent_coef=config.ent_coef,
        seed=config.seed,
        tensorboard_log=str(out / "tensorboard"),
        policy_kwargs={"features_extractor_kwargs": {"net": start.config if start is not None else network}},
        device="cpu",
    )
    if start is not None:
        network_of(model).load_state_dict(start.state_dict())
    return model


def _stretches(config: PpoConfig, cells: Cells, out: Path) -> list[dict[str, Any]]:
    """Return the cells of all stretches of the folder's training, the coming one included.

    Raises:
        TrainingError: The folder holds a training with another configuration.
    """
    path, stretches = out / CONFIG, []
    if path.exists():
        noted = json.loads(path.read_text(encoding="utf-8"))
        if _resumable(_requested(noted)) != _resumable(config.record()):
            raise TrainingError(f"{out} holds a training of another configuration; choose another folder with --out")
        stretches = [Cells.upgraded(values) for values in noted["cells"]]
    if not stretches or stretches[-1] != cells.plain():
        stretches.append(cells.plain())
    return stretches


def _requested(noted: dict[str, Any]) -> dict[str, Any]:
    """Return the configuration that a training was called with; an initial selector may have replaced its network."""
    values: dict[str, Any] = noted["ppo"]
    return {**values, "network": noted.get("requested_network", values["network"])}


def _resumable(values: dict[str, Any]) -> dict[str, Any]:
    """Return the settings, from any version's file, that have to stay the same when a training is resumed."""
    present = without_former_keys(values, PPO_KEYS)
    present.pop("n_envs", None)
    return present
