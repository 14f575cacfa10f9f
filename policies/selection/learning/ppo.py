"""MaskablePPO on `BinPickSelect-v0`: checkpoints, TensorBoard, success rates; the weights are kept as a selector."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from perception.runtime.files import json_text, replace_atomically, write_atomically
from perception.runtime.provenance import command_line, git_commit, versions
from perception.runtime.threads import one_core
from policies.grasping.outcomes import Abstention, GraspOutcome
from policies.selection.env import ABSTAINED
from policies.selection.learning.experience import Cells
from policies.selection.learning.policy import SelectorPolicy
from policies.selection.network import SelectorNet, SelectorNetConfig
from policies.selection.weights import load_selector_net, save_selector

CHECKPOINT, WEIGHTS, CONFIG = "checkpoint.zip", "selector.safetensors", "config.json"
_NO_ATTEMPT = {"", ABSTAINED, *map(str, Abstention)}


@dataclass(frozen=True, kw_only=True)
class PpoConfig:
    """What a training's result depends on, its length and its cells aside."""

    network: SelectorNetConfig = field(default_factory=SelectorNetConfig)
    rollout: int = 128  # picks of each process between updates
    batch: int = 64  # picks of a gradient step
    epochs: int = 6  # passes over a rollout
    rate: float = 3e-4  # Adam's
    discount: float = 0.9  # of rewards to come: what a pick does to the pile shows within some ten picks
    entropy: float = 0.01  # weight of the policy's entropy in the loss
    seed: int = 0  # of weights, order and piles

    def __post_init__(self) -> None:
        for name in ("rollout", "batch", "epochs"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if not (self.rate > 0 and 0 <= self.discount <= 1 and self.entropy >= 0):
            raise ValueError(
                f"rate must be positive, discount in [0, 1], entropy not negative, got {self.rate}, {self.discount} "
                f"and {self.entropy}"
            )


class TrainingError(ValueError):
    """The folder holds another training."""


def train_ppo(
    config: PpoConfig,
    cells: Cells,
    out: Path,
    picks: int,
    *,
    workers: int = 1,
    initial: Path | None = None,
    on_progress: Callable[[int, dict[str, float]], None] | None = None,
) -> Path:
    """Train until ``picks`` have been made in all, from the folder's checkpoint where there is one.

    The cells may change from one call to the next: the last stretch may see with the learned perception. The chance of
    a training that was stopped and resumed is not that of one in one piece.

    Args:
        config: Of network and method.
        cells: What is picked.
        out: Folder of checkpoint, weights, ``tensorboard`` and configuration.
        picks: In all, those before the checkpoint included; whole rollouts are made.
        workers: Processes, one cell each.
        initial: Selector to start from; random weights if None, and without effect where there is a checkpoint.
        on_progress: Called after each rollout with the picks so far and the rates of the last bins.

    Returns:
        Path of the selector.

    Raises:
        TrainingError: The folder holds a training of another configuration.
    """
    stretches = _claim(config, cells, out)
    with one_core():
        vector = _vector(cells, workers, config.seed)
        try:
            model = _model(config, vector, out, initial)
            keeper = _Keeper(out, on_progress)
            model.set_random_seed(config.seed + model.num_timesteps)  # a resumed stretch sees other piles
            model.learn(
                max(picks - model.num_timesteps, 0),
                callback=keeper,
                reset_num_timesteps=False,
                tb_log_name=f"stretch_{len(stretches)}",
            )
        finally:
            vector.close()
        record = {"method": "MaskablePPO", "ppo": asdict(config), "cells": stretches, "picks": model.num_timesteps}
        record |= {"rates": keeper.rates(), "command": command_line(), "commit": git_commit(), "versions": versions()}
        save_selector(out / WEIGHTS, network_of(model), record)
    return out / WEIGHTS


def network_of(model: MaskablePPO) -> SelectorNet:
    """Return the network that a model trains."""
    policy = model.policy
    assert isinstance(policy, SelectorPolicy)
    return policy.network


class _Keeper(BaseCallback):
    """Logs the rates of the last bins, and keeps a checkpoint after each rollout."""

    def __init__(self, out: Path, on_progress: Callable[[int, dict[str, float]], None] | None, bins: int = 50) -> None:
        super().__init__()
        self._out, self._on_progress, self._bins = out, on_progress, bins
        self._finished: list[tuple[int, int, bool]] = []  # delivered, total and success of the last bins
        self._outcomes: list[bool] = []  # of the last attempts

    def rates(self) -> dict[str, float]:
        """Return DR and success rate of the last bins, GSR of about as many picks; NaN without any."""
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
        self._save()  # the update after the last rollout is in it

    def _on_training_end(self) -> None:
        self._save()

    def _save(self) -> None:
        def write(draft: Path) -> None:
            with draft.open("wb") as file:
                self.model.save(file)

        replace_atomically(self._out / CHECKPOINT, write)


def _vector(cells: Cells, workers: int, seed: int) -> VecEnv:
    makers: list[Callable[[], gym.Env[Any, Any]]] = [partial(_monitored, cells) for _ in range(workers)]
    vector: VecEnv = DummyVecEnv(makers) if workers == 1 else SubprocVecEnv(makers, start_method="forkserver")
    vector.seed(seed)
    return vector


def _monitored(cells: Cells) -> Monitor:
    return Monitor(cells.environment())


def _model(config: PpoConfig, vector: VecEnv, out: Path, initial: Path | None) -> MaskablePPO:
    if (out / CHECKPOINT).exists():
        resumed: MaskablePPO = MaskablePPO.load(out / CHECKPOINT, env=vector, tensorboard_log=str(out / "tensorboard"))
        return resumed
    network = config.network
    start = load_selector_net(initial) if initial is not None else None
    model = MaskablePPO(
        SelectorPolicy,
        vector,
        learning_rate=config.rate,
        n_steps=config.rollout,
        batch_size=config.batch,
        n_epochs=config.epochs,
        gamma=config.discount,
        ent_coef=config.entropy,
        seed=config.seed,
        tensorboard_log=str(out / "tensorboard"),
        policy_kwargs={"features_extractor_kwargs": {"net": start.config if start is not None else network}},
        device="cpu",
    )
    if start is not None:
        network_of(model).load_state_dict(start.state_dict())
    return model


def _claim(config: PpoConfig, cells: Cells, out: Path) -> list[dict[str, Any]]:
    """Note the configuration in the folder, or compare with what is noted there; return the cells of all stretches.

    Raises:
        TrainingError: Another configuration is noted.
    """
    mine, path = json.loads(json_text(asdict(config))), out / CONFIG
    stretches: list[dict[str, Any]] = []
    if path.exists():
        noted = json.loads(path.read_text())
        if noted["ppo"] != mine:
            raise TrainingError(f"{out} holds a training of another configuration; choose another folder with --out")
        stretches = noted["cells"]
    if not stretches or stretches[-1] != cells.plain():
        stretches.append(cells.plain())
    write_atomically(path, json_text({"ppo": mine, "cells": stretches}))
    return stretches
