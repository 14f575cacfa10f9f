"""Bins that the learned perceiver is observed on: of one part, or of many generated ones."""

import json
import logging
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.cell.settle import SettleError
from binpick_env.env import BinPickEnv
from binpick_env.evaluation.noise.comparison import FrameObservation, compare_with_truth
from binpick_env.evaluation.segmentation.method import MethodConfig
from binpick_env.evaluation.segmentation.summary import weights_provenance
from binpick_env.jobs.folder_config import ensure_same_config
from binpick_env.jobs.process_map import map_indices
from binpick_env.jobs.workers import Workers
from binpick_env.observation.part_class import PartClass, part_class, size_px
from binpick_env.options import CellOptions
from binpick_env.parts.families.generator import VERSION as GENERATOR_VERSION
from binpick_env.parts.families.names import GeneratedName
from binpick_env.parts.families.registry import FAMILIES
from binpick_env.parts.label import part_label
from binpick_env.scenes.synthesis import MANY_PARTS, SceneConfig, with_room
from perception.runtime.file_work import FolderWork
from perception.runtime.files import json_text, write_atomically
from perception.segmentation.weights import find_weights
from perception.shape import Signature, shape_signature

_log = logging.getLogger(__name__)
# options that older records lack, and their defaults
_NEWER_OPTIONS = {"hand_eye_deg": 0.0, "trust": "camera", "max_acceleration": None, "max_jerk": None}
BINS_PER_PART = 3  # number of successive bins of one of many parts
FIRST_INDEX = 1000  # index within its family of the first generated part; trainings take their parts from 0 on


@dataclass(frozen=True, kw_only=True)
class NoiseBins:
    """The bins that the perceiver is observed on; bin i depends on this and on i alone."""

    options: CellOptions  # cell and part; the part "generated" stands for other generated parts every three bins
    seed: int  # seed of all bins; bin i is drawn from (seed, i)
    num_parts: tuple[int, int]  # smallest and largest number of parts; small ones represent bins that are nearly empty

    @property
    def many(self) -> bool:
        """Whether the bins are of many generated parts."""
        return self.options.part == MANY_PARTS

    def options_of(self, index: int) -> CellOptions:
        """Return cell and part of bin ``index``."""
        return replace(self.options, part=self._generated(index // BINS_PER_PART)) if self.many else self.options

    def _generated(self, number: int) -> str:
        """Return the name of generated part ``number``: of every family in turn, in an order drawn from the seed."""
        order = np.random.default_rng([self.seed]).permutation(len(FAMILIES))
        turn, at = divmod(number, len(FAMILIES))
        return str(GeneratedName(family=list(FAMILIES)[order[at]], index=FIRST_INDEX + turn))

    def weights(self) -> dict[str, Any]:
        """Return path, SHA-256 and training of the network that segments the first bin.

        Raises:
            WeightsError: There are no weights for its part.
        """
        model = self.options_of(0).load_part().model
        found = weights_provenance(MethodConfig(weights=find_weights(model).path), model)
        assert found is not None
        return found

    def plain(self) -> dict[str, Any]:
        """Return everything that the observations depend on, as JSON types."""
        # The label differs between files of different content, the version between generated parts of the same name.
        identity = {"generator": GENERATOR_VERSION} if self.many else {"label": part_label(self.options.part)}
        values = asdict(self)
        for name, default in _NEWER_OPTIONS.items():  # left out, so that folders of older versions can be resumed
            if values["options"][name] == default:
                del values["options"][name]
        return {**values, **identity, "weights": self.weights()["sha256"]}


@dataclass(frozen=True, kw_only=True)
class ObservedBin:
    """One bin of a part, and what the perceiver made of it.

    Attributes:
        part: Name or path of the part.
        signature: Invariants of its shape [m], of which the first is ``d_max``.
        d_max_px: Largest extent of the part in the image [px].
        training: "own", "family" or "zero-shot": whether the network was trained on the part.
        frame: Visible parts and false candidates; None if the pile did not come to rest.
    """

    part: str
    signature: Signature
    d_max_px: float
    training: str
    frame: FrameObservation | None

    @property
    def part_class(self) -> PartClass:
        """Class of the part."""
        return part_class(self.signature, self.d_max_px)

    @classmethod
    def load(cls, path: Path) -> "ObservedBin":
        """Read a bin from its JSON file.

        Raises:
            ValueError: The file is damaged.
        """
        try:
            values = json.loads(path.read_text(encoding="utf-8"))
            frame = None if values["frame"] is None else FrameObservation.from_plain(values["frame"])
            return cls(**{**values, "signature": tuple(values["signature"]), "frame": frame})
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(
                f"{path} holds no observed bin ({error!r}); delete it, and it is observed again"
            ) from error


def observe_bins(config: NoiseBins, count: int, folder: Path, workers: Workers = 1) -> Iterator[int]:
    """Run the learned perceiver once on each of many settled bins; yield the index of each once its file exists.

    Args:
        config: Part, which needs network weights, cell, seed and filling.
        count: Number of bins; those whose files exist are kept.
        folder: Folder of the bins' files; it must not hold bins of another configuration.
        workers: Number of worker processes, or a cluster.

    Raises:
        ValueError: The folder holds bins of another configuration, ``count`` is under 1, or there is no such part.
        WeightsError: (a ValueError) There are no weights for the part.
    """
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    ensure_same_config(folder / "bins.json", config.plain(), "bins")
    missing = [index for index in range(count) if not bin_path(folder, index).exists()]
    yield from (index for index in range(count) if index not in missing)
    yield from map_indices(FolderWork(partial(_observe_bin, config), folder), missing, workers)


def bin_path(folder: Path, index: int) -> Path:
    """Return the path of the file of bin ``index``."""
    return folder / f"bin_{index:05d}.json"


def load_bins(folder: Path, count: int) -> list[ObservedBin]:
    """Read bins 0 to ``count - 1``.

    Raises:
        ValueError: A file is damaged.
        FileNotFoundError: A bin has not been observed.
    """
    return [ObservedBin.load(bin_path(folder, index)) for index in range(count)]


_cells: dict[tuple[Any, ...], BinPickEnv] = {}  # the last environment of this process, which takes seconds to build


def _observe_bin(config: NoiseBins, folder: Path, index: int) -> int:
    options = config.options_of(index)
    key = (options, config.num_parts)
    if key not in _cells:
        _cells.clear()  # before the next one is built: each holds hundreds of megabytes
        _cells[key] = _environment(options, config)
    env, frame = _cells[key], None
    try:
        env.reset(seed=int(np.random.SeedSequence([config.seed, index]).generate_state(1)[0]))
        frame = compare_with_truth(env.labelled_capture, env.observed)
    except SettleError as error:
        _log.warning("bin %d of %s is left out: %s", index, options.part, error)
    model = env.part.model
    observed = ObservedBin(
        part=options.part,
        signature=shape_signature(model),
        d_max_px=size_px(model.d_max, env.config.camera),
        training=find_weights(model).training,
        frame=frame,
    )
    write_atomically(bin_path(folder, index), json_text(asdict(observed), indent=None))
    return index


def _environment(options: CellOptions, config: NoiseBins) -> BinPickEnv:
    filled = config.num_parts
    if config.many:
        filled = with_room(SceneConfig(part=options.part, bin=options.bin, num_parts=filled)).num_parts
    return BinPickEnv(
        options.load_part(),
        num_parts=filled,
        perception="learned",
        sensor=options.sensor,
        config=options.cell(),
        threads=1,
    )
