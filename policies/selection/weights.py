"""Trained selectors on disk: safetensors files that also hold what made them, with a JSON of it beside for people."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file

from perception.runtime.files import json_text, write_atomically
from perception.runtime.tensor_files import save_tensors
from policies.selection.features import FEATURES
from policies.selection.network import SelectorNet, SelectorNetConfig

SELECTOR_VERSION = 1


class SelectorError(ValueError):
    """A file does not hold a whole selector of this version."""


def save_selector(path: Path, network: SelectorNet, record: dict[str, Any]) -> None:
    """Write ``path`` (safetensors), which holds the record too, and the record as JSON beside it, each in one piece.

    Args:
        path: Ends with ``.safetensors``.
        network: On any device.
        record: How it was trained: anything JSON holds.
    """
    text = json_text({"version": SELECTOR_VERSION, "network": asdict(network.config), **record})
    save_tensors(path, network.state_dict(), {"record": text})
    write_atomically(path.with_suffix(".json"), text)


def load_selector_record(path: Path) -> dict[str, Any]:
    """Read what a ``.safetensors`` file says of its selector.

    Raises:
        SelectorError: The file is missing, damaged, of another version, or not one of :func:`save_selector`.
    """
    try:
        with safe_open(path, framework="pt") as file:
            record: dict[str, Any] = json.loads(file.metadata()["record"])
        version = record["version"]
    except (OSError, SafetensorError, ValueError, KeyError, TypeError) as error:
        raise SelectorError(f"{path} holds no selector of this project ({error})") from error
    if version != SELECTOR_VERSION:
        raise SelectorError(f"{path} is of version {version}, this code reads {SELECTOR_VERSION}")
    return record


def load_selector_net(path: Path) -> SelectorNet:
    """Return the network of a ``.safetensors`` file, in evaluation mode, on the CPU.

    Raises:
        SelectorError: The file is missing or damaged, its weights do not fit the network that it describes, or it uses
            features that there are no longer.
    """
    values = load_selector_record(path)["network"]
    try:
        if gone := sorted(set(values["features"]) - set(FEATURES)):
            raise SelectorError(f"{path} was trained on features that there are not ({', '.join(gone)})")
        config = SelectorNetConfig(**{**values, "features": tuple(values["features"])})
        network = SelectorNet(config)
        network.load_state_dict(load_file(path))
    except (OSError, KeyError, TypeError, RuntimeError, SafetensorError) as error:
        raise SelectorError(f"{path} does not hold the selector that it describes ({error})") from error
    return network.eval()
