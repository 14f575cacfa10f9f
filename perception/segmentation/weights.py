"""Files of trained networks: safetensors with a record of the training, which is also written as JSON beside them."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from shutil import copyfile
from typing import Any, Literal, get_args

from torch import Tensor

from perception.part import PartModel
from perception.runtime.files import replace_atomically, write_atomically
from perception.runtime.job_files import installed_weights
from perception.runtime.records import RecordError, RecordFormat
from perception.runtime.tensor_shapes import filled
from perception.segmentation.choices import NetworkName
from perception.segmentation.networks.context_net import ContextNet, ContextNetConfig
from perception.segmentation.networks.grid_net import GridNet, GridNetConfig
from perception.segmentation.networks.sgpn import Sgpn, SgpnConfig
from perception.shape import same_shape, shape_signature

_log = logging.getLogger(__name__)
SHIPPED = Path(__file__).resolve().parents[1] / "weights"
SHARED = "shared"  # name of a network for several parts; the shipped one is for the catalogue
GENERAL = "general"  # name of the network for every part
GENERATIONS = 4  # number of networks, each the start of the next, that a record describes in any case
# What a record tells of the networks before the one that the training started from.
_KEPT = ("parts", "shapes", "families", "general", "steps", "minutes", "scenes", "validation", "git_commit")
Network = GridNet | Sgpn | ContextNet
NetworkConfig = GridNetConfig | SgpnConfig | ContextNetConfig
_KINDS: dict[str, tuple[type[NetworkConfig], type[Network]]] = {
    "grid": (GridNetConfig, GridNet),
    "sgpn": (SgpnConfig, Sgpn),
    "context": (ContextNetConfig, ContextNet),
}


class WeightsError(RecordError):
    """There are no weights for a part, or a file does not hold a complete network of this version."""


FORMAT = RecordFormat(
    kind="segmentation network", version=1, remedy="train_segmentation makes networks", error=WeightsError
)


def build_network(config: NetworkConfig) -> Network:
    """Return a network with weights drawn from torch's global generator."""
    _, network_type = next(pair for pair in _KINDS.values() if isinstance(config, pair[0]))
    network: Network = network_type(config)  # type: ignore[arg-type]
    return network.float()  # whatever torch's default type is in the caller's program


def save_network(path: Path, network: Network, record: dict[str, Any], *, half: bool = False) -> None:
    """Write a network with its record as safetensors, and the record as JSON beside it, each atomically.

    Args:
        path: File to write; its name ends with ``.safetensors``.
        network: Network on any device.
        record: Description of the training, anything that JSON holds; ``parts`` names the parts that it was trained on.
        half: Store the learned parameters in 16 bits, which halves the file. They are float32 again when loaded.
    """
    kind = next(kind for kind, (_, network_type) in _KINDS.items() if isinstance(network, network_type))
    tensors = dict(network.state_dict())
    if half:
        tensors |= {name: parameter.detach().half() for name, parameter in network.named_parameters()}
    text = FORMAT.save_tensors(path, tensors, {"kind": kind, "network": asdict(network.config), **record})
    write_atomically(path.with_suffix(".json"), text)


def network_name(record: dict[str, Any]) -> NetworkName | None:
    """Return the kind of network that a record belongs to; None for one over points with PointNet's trunk."""
    names: dict[str, NetworkName] = {"grid": "grid", "context": "dgcnn-context"}
    if record.get("kind") == "sgpn" and record["network"].get("trunk") == "dgcnn":
        return "dgcnn-sgpn"
    return names.get(record.get("kind", "grid"))


def weights_name(name: str, network: NetworkName) -> str:
    """Return the name that weights are kept under, for a part's name, :data:`GENERAL` or :data:`SHARED`."""
    return name if network == "grid" else f"{name}-{network}"


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
    sizes: dict[str, Any] = record["network"]
    values: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in sizes.items()}
    config = config_type(**values)
    network: Network = filled(lambda: network_type(config), tensors)  # type: ignore[arg-type]
    return network.eval()


Training = Literal["own", "family", "zero-shot"]
Records = Sequence[tuple[Path, dict[str, Any]]]  # files of networks, each with its record


@dataclass(frozen=True, kw_only=True)
class FoundWeights:
    """Weights for a part.

    Attributes:
        path: ``.safetensors`` file.
        training: "own" if the part was trained on, "family" if parts of its family were, else "zero-shot".
    """

    path: Path
    training: Training


def training_of(record: dict[str, Any], part: PartModel) -> Training:
    """Tell from a record whether a network, or one that it was started from, was trained on a part.

    The part is recognised by its shape, see :func:`shape_signature`. Records without shapes, of older versions, are
    matched by name. A generated part, whose name is ``generated:FAMILY:INDEX``, has a family besides.
    """
    known: Training = "zero-shot"
    for ancestor in _lineage(record):
        if _knows(ancestor, part):
            return "own"
        if ":".join(part.name.split(":")[:2]) in ancestor.get("families", []):
            known = "family"
    return known


def record_of_initial(record: dict[str, Any]) -> dict[str, Any]:
    """Return the record of the network that a training starts from, in the form that the new record stores.

    It is stored whole, and of the networks before it the main facts. Networks more than :data:`GENERATIONS` back are
    left out unless they were trained on parts that no later one was trained on. The size of a record is therefore
    limited by the number of different parts, not by the number of trainings.
    """
    kept: list[dict[str, Any]] = []
    for ancestor in _lineage(record):
        if len(kept) < GENERATIONS or _adds_parts(ancestor, kept):
            kept.append({name: ancestor[name] for name in _KEPT if name in ancestor} if kept else ancestor)
    stored: dict[str, Any] | None = None
    for ancestor in reversed(kept):
        stored = ancestor | {"initial": stored}
    return stored or {}


def _lineage(record: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a record, that of the network its training started from, and so on."""
    ancestor: dict[str, Any] | None = record
    while ancestor is not None:
        yield ancestor
        ancestor = ancestor.get("initial")


def _adds_parts(record: dict[str, Any], others: Sequence[dict[str, Any]]) -> bool:
    """Tell whether a network was trained on a part or a family that none of the others was trained on."""
    if set(record.get("families", [])) - {family for other in others for family in other.get("families", [])}:
        return True
    if record.get("shapes") is None:
        named = [other for other in others if other.get("shapes") is None]
        return bool(set(record.get("parts", [])) - {name for other in named for name in other.get("parts", [])})
    known = [shape for other in others for shape in (other.get("shapes") or {}).values()]
    return any(not any(same_shape(shape, other) for other in known) for shape in record["shapes"].values())


def find_weights(part: PartModel, network: NetworkName = "grid") -> FoundWeights:
    """Return the weights for a part: those that were trained on its shape, or else those for every part.

    Weights for the part alone precede weights for several parts; the user's precede shipped ones. A warning is logged
    if the user's own weights of the part are all of other kinds.

    Args:
        part: Part to recognise.
        network: Kind of network.

    Raises:
        WeightsError: There are neither weights of the part nor for every part, of this kind.
        ValueError: There is no such kind of network.
    """
    all_records = _all_records()
    records = _of_kind(all_records, network)
    _warn_of_other_kinds(all_records, part, network)
    own = _trained_on(records, part)
    if own:
        path, _ = min(own, key=lambda found: len(found[1].get("parts", [])) > 1)
        return FoundWeights(path=path, training="own")
    general = _for_every_part(records, network)
    if general is None:
        raise WeightsError(
            f"there are no segmentation weights{_of_network(network)} for {part.name!r} and none for every part: make "
            f"scenes with binpick generate-scenes, and train with binpick train-segmentation{_preset(network)}, which "
            f"installs in {user_folder()}"
        )
    return FoundWeights(path=general, training=training_of(load_record(general), part))


def general_weights(network: NetworkName = "grid") -> Path:
    """Return the weights for every part, or those for several parts if there are none; the user's precede shipped ones.

    A training on a single part starts from them, and clouds of an unknown part are segmented by them.

    Args:
        network: Kind of network.

    Raises:
        WeightsError: There are neither, of this kind.
        ValueError: There is no such kind of network.
    """
    general = _for_every_part(_of_kind(_all_records(), network), network)
    if general is None:
        raise WeightsError(
            f"there are no segmentation weights{_of_network(network)} for every part, neither in {user_folder()} nor "
            f"in {SHIPPED}: binpick train-segmentation --part generated{_preset(network)} makes them"
        )
    return general


def _warn_of_other_kinds(records: Records, part: PartModel, network: NetworkName) -> None:
    """Log a warning if the user's own weights of a part are all of other kinds than the one asked for."""
    own = [(path, network_name(record)) for path, record in _trained_on(records, part) if path.parent == user_folder()]
    if any(kind == network for _, kind in own):
        return
    for path, kind in own:
        if kind is not None:
            needs = ", which needs frames with depth" if kind == "grid" else ""
            text = "%s was trained on %s, but not for the network %s: it is used with --network %s%s"
            _log.warning(text, path, part.name, network, kind, needs)


def _of_network(network: NetworkName) -> str:
    return "" if network == "grid" else f" of the network {network}"


def _preset(network: NetworkName) -> str:
    return "" if network == "grid" else f" --preset {network} --install True"


def _for_every_part(records: Records, network: NetworkName) -> Path | None:
    general = [path for path, record in records if record.get("general")]
    # Without a network for every part, one for several parts serves: it knows d_max and nothing else of a part.
    # Older versions installed every kind of network under the bare name.
    general += [path for path, _ in records if path.stem in (SHARED, weights_name(SHARED, network))]
    return general[0] if general else None


def _knows(record: dict[str, Any], part: PartModel) -> bool:
    """Tell whether a network was itself trained on a part."""
    shapes: dict[str, list[float]] | None = record.get("shapes")
    if shapes is None:
        return part.name in record.get("parts", [])
    signature = shape_signature(part) if shapes else ()
    return any(same_shape(shape, signature) for shape in shapes.values())


def _trained_on(records: Records, part: PartModel) -> Records:
    """Return the networks that were themselves trained on a part, besides those for every part."""
    return [(path, record) for path, record in records if not record.get("general") and _knows(record, part)]


def _all_records() -> Records:
    """Return the networks of the user, then the shipped ones."""
    return [each for folder in (user_folder(), SHIPPED) for each in _records(folder)]


def _of_kind(records: Records, network: NetworkName) -> Records:
    if network not in get_args(NetworkName):
        raise ValueError(f"network must be one of {', '.join(get_args(NetworkName))}, got {network!r}")
    return [(path, record) for path, record in records if network_name(record) == network]


def _records(folder: Path) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Yield the files of networks in a folder with their records; damaged ones are left out with a warning."""
    for path in sorted(folder.glob("*.safetensors")):
        try:
            yield path, load_record(path)
        except WeightsError as error:
            _log.warning("left out: %s", error)


def install_weights(path: Path, name: str) -> Path:
    """Copy weights and their JSON to the user's folder; return the path of the copy.

    Args:
        path: ``.safetensors`` file of a network.
        name: Part's name, :data:`GENERAL` or :data:`SHARED`. The kind of network is appended, see
            :func:`weights_name`.

    Raises:
        WeightsError: The file is damaged, or its network is of a kind that no command looks for.
    """
    network = network_name(load_record(path))
    if network is None:
        raise WeightsError(
            f"{path} cannot be installed, since no command looks for its network: give the file by --weights"
        )
    target = user_folder() / f"{weights_name(name, network)}.safetensors"
    for suffix in (".safetensors", ".json"):
        source = path.with_suffix(suffix)
        replace_atomically(target.with_suffix(suffix), partial(copyfile, source))
    return target


def user_folder() -> Path:
    """Return the folder of the user's own weights, in the cache folder."""
    return installed_weights()
