"""Checkpoints of MaskablePPO, those of version 0.1.0 included."""

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sb3_contrib import MaskablePPO
from stable_baselines3.common.vec_env import VecEnv

# Present module of each class that a checkpoint names, by its former one; they are read until the next minor version.
_FORMER_MODULES = {
    "policies.selector_net": "policies.selection.network",
    "policies.selector_policy": "policies.selection.learning.policy",
}


def load_checkpoint(path: Path, env: VecEnv, tensorboard: Path) -> MaskablePPO:
    """Load a checkpoint to train further.

    Args:
        path: The .zip file that SB3 wrote.
        env: Environments to train in.
        tensorboard: Folder of TensorBoard's events.
    """
    with _former_modules():
        model: MaskablePPO = MaskablePPO.load(path, env=env, tensorboard_log=str(tensorboard))
    return model


@contextmanager
def _former_modules() -> Iterator[None]:
    """Let pickled classes be found under the names that their modules had before they moved."""
    for former, present in _FORMER_MODULES.items():
        sys.modules[former] = importlib.import_module(present)
    try:
        yield
    finally:
        for former in _FORMER_MODULES:
            sys.modules.pop(former, None)
