"""Checkpoints: the complete state of a training in one safetensors file, from which it is resumed to the bit."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from perception.runtime.files import json_text
from perception.runtime.records import RecordError, RecordFormat
from perception.segmentation.networks.precision import bfloat16_is_fast
from perception.segmentation.training.loop import Trainer


class CheckpointError(RecordError):
    """A file does not hold a complete checkpoint of this training."""


FORMAT = RecordFormat(
    kind="checkpoint", version=1, remedy="choose another --out, or delete the file", error=CheckpointError
)


def save_checkpoint(path: Path, trainer: Trainer) -> None:
    """Write network, average, optimizer, step, time, losses to be logged and the first network's record, atomically."""
    tensors: dict[str, Tensor] = {}
    for prefix, module in (("network", trainer.network), ("averaged", trainer.averaged)):
        tensors |= {f"{prefix}/{name}": value for name, value in module.state_dict().items()}
    for index, values in trainer.optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer/{index}/{name}": torch.as_tensor(value) for name, value in values.items()}
    state = {"step": trainer.step, "elapsed": trainer.elapsed, "initial": trainer.initial, "unlogged": trainer.unlogged}
    FORMAT.save_tensors(path, tensors, {**_identity(trainer), **state})


def load_checkpoint(path: Path, trainer: Trainer) -> None:
    """Set ``trainer`` to the state in a checkpoint.

    Raises:
        CheckpointError: The file is damaged, or belongs to a training with other settings or scenes, which the message
            names.
    """
    facts, tensors = FORMAT.load_tensors(path, _with_numbers)
    mine = _identity(trainer)
    different = [
        f"{name}: {facts.get(name)} there, {mine[name]} here" for name in mine if facts.get(name) != mine[name]
    ]
    if different:
        raise CheckpointError(
            f"{path} belongs to another training ({'; '.join(different)}); choose another --out, or delete it"
        )
    try:
        trainer.network.load_state_dict(_with_prefix(tensors, "network/"))
        trainer.averaged.load_state_dict(_with_prefix(tensors, "averaged/"))
        trainer.optimizer.load_state_dict({**trainer.optimizer.state_dict(), "state": _optimizer_state(tensors)})
    except (RuntimeError, KeyError, ValueError) as error:
        raise CheckpointError(f"{path} does not fit the network of its own settings ({error})") from error
    trainer.step, trainer.elapsed = facts["step"], facts["elapsed"]
    trainer.initial = facts.get("initial", trainer.initial)  # older checkpoints hold neither this nor the next
    trainer.unlogged = facts.get("unlogged", [])


def _with_numbers(facts: dict[str, Any], tensors: dict[str, Tensor]) -> tuple[dict[str, Any], dict[str, Tensor]]:
    return {**facts, "step": int(facts["step"]), "elapsed": float(facts["elapsed"])}, tensors


def _identity(trainer: Trainer) -> dict[str, Any]:
    """Return the settings that a resumed training must share, as JSON holds them."""
    values = {
        "version": FORMAT.version,
        **asdict(trainer.config),
        **asdict(trainer.length),
        "scenes": trainer.batches.digest(),
        "processes": trainer.world,
        "bfloat16": trainer.config.bf16 and bfloat16_is_fast(trainer.device),
    }
    plain: dict[str, Any] = json.loads(json_text(values))
    if not plain["network"].get("shape", True):
        del plain["network"]["shape"]  # older checkpoints do not know it
    return plain


def _optimizer_state(tensors: dict[str, Tensor]) -> dict[int, dict[str, Tensor]]:
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in _with_prefix(tensors, "optimizer/").items():
        index, _, field = name.partition("/")
        state.setdefault(int(index), {})[field] = value
    return state


def _with_prefix(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name[len(prefix) :]: value for name, value in tensors.items() if name.startswith(prefix)}
