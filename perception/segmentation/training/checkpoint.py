"""The whole state of a training in one safetensors file, from which it goes on as if it had never stopped."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from perception.runtime.files import json_text
from perception.runtime.tensor_files import save_tensors
from perception.segmentation.networks.precision import bfloat16_is_fast
from perception.segmentation.training.loop import Trainer

CHECKPOINT_VERSION = 1  # raise it when the state changes its meaning


class CheckpointError(ValueError):
    """A file does not hold a whole checkpoint of this training."""


def save_checkpoint(path: Path, trainer: Trainer) -> None:
    """Write network, average, optimizer, step and time in one piece."""
    tensors: dict[str, Tensor] = {}
    for prefix, module in (("network", trainer.network), ("averaged", trainer.averaged)):
        tensors |= {f"{prefix}/{name}": value for name, value in module.state_dict().items()}
    for index, values in trainer.optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer/{index}/{name}": torch.as_tensor(value) for name, value in values.items()}
    state = {"step": trainer.step, "elapsed": trainer.elapsed}
    save_tensors(path, tensors, {"training": json_text({**_identity(trainer), **state})})


def load_checkpoint(path: Path, trainer: Trainer) -> None:
    """Put ``trainer`` where the checkpoint's training stood.

    Raises:
        CheckpointError: The file is damaged, or of a training with other settings or scenes; the text names them.
    """
    try:
        with safe_open(path, framework="pt") as file:
            facts = json.loads(file.metadata()["training"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no mapping
        step, elapsed = int(facts["step"]), float(facts["elapsed"])
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        raise CheckpointError(f"{path} holds no whole checkpoint ({error})") from error
    mine = _identity(trainer)
    different = [
        f"{name}: {facts.get(name)} there, {mine[name]} here" for name in mine if facts.get(name) != mine[name]
    ]
    if different:
        raise CheckpointError(
            f"{path} belongs to another training ({'; '.join(different)}); choose another --out, or delete it"
        )
    try:
        trainer.network.load_state_dict(_under(tensors, "network/"))
        trainer.averaged.load_state_dict(_under(tensors, "averaged/"))
        trainer.optimizer.load_state_dict({**trainer.optimizer.state_dict(), "state": _optimizer_state(tensors)})
    except (RuntimeError, KeyError, ValueError) as error:
        raise CheckpointError(f"{path} does not fit the network of its own settings ({error})") from error
    trainer.step, trainer.elapsed = step, elapsed


def _identity(trainer: Trainer) -> dict[str, Any]:
    """Return what must be the same for a training to go on as if it had never stopped, as JSON holds it."""
    values = {
        "version": CHECKPOINT_VERSION,
        **asdict(trainer.config),
        **asdict(trainer.length),
        "scenes": trainer.batches.digest(),
        "processes": trainer.world,
        "bfloat16": trainer.config.bf16 and bfloat16_is_fast(trainer.device),
    }
    plain: dict[str, Any] = json.loads(json_text(values))
    return plain


def _optimizer_state(tensors: dict[str, Tensor]) -> dict[int, dict[str, Tensor]]:
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in _under(tensors, "optimizer/").items():
        index, _, field = name.partition("/")
        state.setdefault(int(index), {})[field] = value
    return state


def _under(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name[len(prefix) :]: value for name, value in tensors.items() if name.startswith(prefix)}
