"""Files of trained selectors: safetensors with a record of the training, and the record as JSON beside it."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from torch import Tensor

from perception.runtime.files import write_atomically
from perception.runtime.records import RecordError, RecordFormat
from perception.runtime.tensor_shapes import filled
from policies.selection.features import FEATURES
from policies.selection.network import SelectorNet, SelectorNetConfig


class SelectorError(RecordError):
    """A file does not hold a whole selector of this version."""


FORMAT = RecordFormat(kind="selector", version=1, remedy="train_selector makes selectors", error=SelectorError)


def save_selector(path: Path, network: SelectorNet, record: dict[str, Any]) -> None:
    """Write network and record to ``path``, and the record as JSON beside it; each file is whole or absent.

    Args:
        path: File to write, with suffix ``.safetensors``.
        network: Trained network on any device.
        record: Facts about the training, as values that JSON can hold.
    """
    text = FORMAT.save_tensors(path, network.state_dict(), {"network": asdict(network.config), **record})
    write_atomically(path.with_suffix(".json"), text)


def load_selector_record(path: Path) -> dict[str, Any]:
    """Return the record in a ``.safetensors`` file.

    Raises:
        SelectorError: The file is missing, damaged, of another version, or not one of :func:`save_selector`.
    """
    return FORMAT.load_header(path)


def load_selector_net(path: Path) -> SelectorNet:
    """Return the network of a ``.safetensors`` file, in evaluation mode, on the CPU.

    Raises:
        SelectorError: The file is missing or damaged, its weights do not fit the network in its record, or the network
            uses features that no longer exist.
    """
    return FORMAT.load_tensors(path, _network_of)


def _network_of(record: dict[str, Any], tensors: dict[str, Tensor]) -> SelectorNet:
    values = record["network"]
    if gone := sorted(set(values["features"]) - set(FEATURES)):
        raise ValueError(f"it was trained on features that do not exist: {', '.join(gone)}")
    config = SelectorNetConfig(**{**values, "features": tuple(values["features"])})
    return filled(lambda: SelectorNet(config), tensors).eval()
