"""Files of trained networks: safetensors with a record of the training, which is also written as JSON beside them."""

from dataclasses import asdict
from functools import partial
from pathlib import Path
from shutil import copyfile
from typing import Any

from torch import Tensor

from perception.runtime.cache import cache_folder
from perception.runtime.files import replace_atomically, write_atomically
from perception.runtime.records import RecordError, RecordFormat
from perception.segmentation.networks.grid_net import GridNet, GridNetConfig
from perception.segmentation.networks.sgpn import Sgpn, SgpnConfig

SHIPPED = Path(__file__).resolve().parents[1] / "weights"
SHARED = "shared"  # the network for every part of the catalogue
Network = GridNet | Sgpn
_KINDS: dict[str, tuple[type[GridNetConfig] | type[SgpnConfig], type[GridNet] | type[Sgpn]]] = {
    "grid": (GridNetConfig, GridNet),
    "sgpn": (SgpnConfig, Sgpn),
}


class WeightsError(RecordError):
    """There are no weights for a part, or a file does not hold a complete network of this version."""


FORMAT = RecordFormat(
    kind="segmentation network", version=1, remedy="train_segmentation makes networks", error=WeightsError
)


def build_network(config: GridNetConfig | SgpnConfig) -> Network:
    """Return a network with weights drawn from torch's global generator."""
    return GridNet(config) if isinstance(config, GridNetConfig) else Sgpn(config)


def save_network(path: Path, network: Network, record: dict[str, Any], *, half: bool = False) -> None:
    """Write a network with its record as safetensors, and the record as JSON beside it, each atomically.

    Args:
        path: File to write; its name ends with ``.safetensors``.
        network: Network on any device.
        record: Description of the training, anything that JSON holds; ``parts`` names the parts that it was trained on.
        half: Store the learned parameters in 16 bits, which halves the file. They are float32 again when loaded.
    """
    kind = "grid" if isinstance(network, GridNet) else "sgpn"
    tensors = dict(network.state_dict())
    if half:
        tensors |= {name: parameter.detach().half() for name, parameter in network.named_parameters()}
    text = FORMAT.save_tensors(path, tensors, {"kind": kind, "network": asdict(network.config), **record})
    write_atomically(path.with_suffix(".json"), text)


def load_record(path: Path) -> dict[str, Any]:
    """Return the record in a ``.safetensors`` file.

    Raises:
        WeightsError: The file is missing, damaged, of another version, or not written by :func:`save_network`.
    """
    return FORMAT.load_header(path)


def load_network(path: Path) -> Network:
    """Return the network of a ``.safetensors`` file, in evaluation mode, on the CPU.

    Raises:
        WeightsError: The file is missing or damaged, or its weights do not fit the network that it describes.
    """
    return FORMAT.load_tensors(path, _network_of)


def _network_of(record: dict[str, Any], tensors: dict[str, Tensor]) -> Network:
    if record["kind"] not in _KINDS:
        raise ValueError(f"its network must be one of {', '.join(_KINDS)}, got {record['kind']!r}")
    config_type, network_type = _KINDS[record["kind"]]
    values = {name: tuple(v) if isinstance(v, list) else v for name, v in record["network"].items()}
    network: Network = network_type(config_type(**values))  # type: ignore[arg-type]
    network.load_state_dict(tensors)
    return network.eval()


def find_weights(part: str) -> Path:
    """Return the path of the weights for a part.

    Weights for the part alone precede shared ones; among these, the user's precede shipped ones.

    Args:
        part: Catalogue name, or the stem of a mesh file.

    Raises:
        WeightsError: There are no weights for the part; the message names the commands that make them.
    """
    own = user_folder()
    for folder in (own, SHIPPED):
        if (folder / f"{part}.safetensors").exists():
            return folder / f"{part}.safetensors"
    for folder in (own, SHIPPED):
        shared = folder / f"{SHARED}.safetensors"
        if shared.exists() and part in load_record(shared).get("parts", []):
            return shared
    raise WeightsError(
        f"there are no segmentation weights for {part!r}: train them with binpick generate-scenes --part {part} and "
        f"binpick train-segmentation --part {part}, which puts them into {own}"
    )


def install_weights(path: Path, name: str) -> Path:
    """Copy weights and their JSON to the user's folder under ``name``; return the path of the copy."""
    target = user_folder() / f"{name}.safetensors"
    for suffix in (".safetensors", ".json"):
        source = path.with_suffix(suffix)
        replace_atomically(target.with_suffix(suffix), partial(copyfile, source))
    return target


def user_folder() -> Path:
    """Return the folder of the user's own weights, in the cache folder."""
    return cache_folder() / "weights"
