"""The whole state of a training in one safetensors file, from which it goes on as if it had never stopped."""

import json
from dataclasses import asdict
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from perception.files import json_text, replace_atomically
from perception.segmentation.training import Trainer


class CheckpointError(ValueError):
    """A file does not hold a whole checkpoint of this training."""


def save_checkpoint(path: Path, trainer: Trainer) -> None:
    """Write network, average, optimizer, step and time in one piece."""
    tensors: dict[str, Tensor] = {}
    for prefix, module in (("network", trainer.network), ("averaged", trainer.averaged)):
        tensors |= {f"{prefix}/{name}": value for name, value in module.state_dict().items()}
    for index, values in trainer.optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer/{index}/{name}": torch.as_tensor(value) for name, value in values.items()}
    facts = {
        "config": json.loads(json_text(asdict(trainer.config))),
        "length": asdict(trainer.length),
        "step": trainer.step,
        "elapsed": trainer.elapsed,
    }
    whole = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    replace_atomically(path, lambda draft: save_file(whole, draft, metadata={"training": json_text(facts)}))


def load_checkpoint(path: Path, trainer: Trainer) -> None:
    """Put ``trainer`` where the checkpoint's training stood.

    Raises:
        CheckpointError: The file is damaged, or of a training with other settings; the text names them.
    """
    try:
        with safe_open(path, framework="pt") as file:
            facts = json.loads(file.metadata()["training"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no mapping
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        raise CheckpointError(f"{path} holds no whole checkpoint ({error})") from error
    mine = {"config": json.loads(json_text(asdict(trainer.config))), "length": asdict(trainer.length)}
    different = [
        f"{name}: {facts[group].get(name)} there, {value} here"
        for group, values in mine.items()
        for name, value in values.items()
        if facts[group].get(name) != value
    ]
    if different:
        raise CheckpointError(
            f"{path} belongs to another training ({'; '.join(different)}); choose another --out, or delete it"
        )
    trainer.network.load_state_dict(_under(tensors, "network/"))
    trainer.averaged.load_state_dict(_under(tensors, "averaged/"))
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in _under(tensors, "optimizer/").items():
        index, _, field = name.partition("/")
        state.setdefault(int(index), {})[field] = value
    trainer.optimizer.load_state_dict({**trainer.optimizer.state_dict(), "state": state})
    trainer.step, trainer.elapsed = int(facts["step"]), float(facts["elapsed"])


def _under(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name[len(prefix) :]: value for name, value in tensors.items() if name.startswith(prefix)}
