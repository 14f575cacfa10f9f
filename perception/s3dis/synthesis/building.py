"""Synthetic furnished rooms in the format of S3DIS, to test the protocol without the data set."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats
from perception.runtime.file_work import FolderWork, Run
from perception.runtime.files import make_folder_atomically
from perception.s3dis.data.categories import AREAS
from perception.s3dis.data.raw_tree import MEMBERS
from perception.s3dis.synthesis.furnishing import KINDS, make_interior
from perception.s3dis.synthesis.solids import Brush, Cloud

COLOUR_NOISE = 7.0  # standard deviation of the noise on a colour, on a scale of 255


@dataclass(frozen=True, kw_only=True)
class SynthesisConfig:
    """Settings of the synthesis.

    Attributes:
        seed: Seed; room i depends on the seed and i alone.
        density: Number of points per square metre of surface. S3DIS has 273 million points on 6020 square metres of
            floor, which corresponds to about 9000 here. At 1000, a block has about 5000 points.
        noise: Standard deviation of the measured coordinates [m].
    """

    seed: int = 0
    density: float = 1000.0
    noise: float = 0.003

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, got {self.seed}")
        if not self.density > 0 or not self.noise >= 0:
            raise ValueError(f"density must be positive and noise not negative, got {self.density} and {self.noise}")


class ScannedObject(NamedTuple):
    """An object of a scanned room.

    Attributes:
        name: Category and number, such as "chair_2".
        xyz: (N, 3) points in the building frame [m].
        rgb: (N, 3) colours.
    """

    name: str
    xyz: Floats
    rgb: NDArray[np.uint8]


def room_name(config: SynthesisConfig, index: int) -> str:
    """Return the name of a room, such as "Area_1/office_1"; areas alternate, and the kind is random."""
    kinds = list(KINDS)
    kind = kinds[int(_rng(config, index).integers(len(kinds)))]
    return f"Area_{AREAS[index % len(AREAS)]}/{kind}_{index // len(AREAS) + 1}"


def make_room(config: SynthesisConfig, index: int) -> list[ScannedObject]:
    """Return the objects of room ``index``, which depend on the settings and the index alone."""
    rng = _rng(config, index)
    kind = KINDS[list(KINDS)[int(rng.integers(len(KINDS)))]]
    items = make_interior(kind, Brush(config.density, rng))
    offset = np.append(rng.uniform(-30, 30, 2), rng.uniform(-0.5, 0.5))
    lamp = rng.uniform([0.5, 0.5, 2.2], [kind.width[0], kind.depth[0], 2.6])
    numbers = Counter[str]()
    scanned = []
    for category, cloud in items:
        if not len(cloud.points):
            continue
        numbers[category] += 1
        xyz = cloud.points + rng.normal(0, config.noise, cloud.points.shape) + offset
        scanned.append(ScannedObject(f"{category}_{numbers[category]}", xyz, _lit(cloud, lamp, rng)))
    return scanned


def synthesize_rooms(config: SynthesisConfig, count: int, out: Path, run: Run[str] = map) -> Iterator[str]:
    """Write rooms 0 to ``count - 1`` and yield the name of each; rooms that exist are kept.

    Args:
        config: Settings of the synthesis.
        count: Number of rooms.
        out: Root of the tree.
        run: Maps work over the indices of the rooms to make.

    Raises:
        ValueError: ``count`` is below 1.
    """
    if count < 1:
        raise ValueError(f"rooms must be at least 1, got {count}")
    names = [room_name(config, index) for index in range(count)]
    missing = [index for index, name in enumerate(names) if not (out / name).exists()]
    made = run(FolderWork(partial(_write_room, config), out), missing)
    return chain((name for index, name in enumerate(names) if index not in missing), made)


def _rng(config: SynthesisConfig, index: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence([config.seed, index]))


def _lit(cloud: Cloud, lamp: Floats, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return the colours of an object under a lamp, with a random brightness and noise on every point."""
    towards = lamp - cloud.points
    cosine = np.abs((towards * cloud.normals).sum(axis=1)) / np.maximum(np.linalg.norm(towards, axis=1), 1e-6)
    light = rng.uniform(0.9, 1.1) * (0.6 + 0.4 * cosine)
    noisy = cloud.colours * light[:, None] + rng.normal(0, COLOUR_NOISE, cloud.colours.shape)
    colours: NDArray[np.uint8] = np.clip(np.round(noisy), 0, 255).astype(np.uint8)
    return colours


def _write_room(config: SynthesisConfig, out: Path, index: int) -> str:
    """Write the folder of a room, atomically."""
    objects, name = make_room(config, index), room_name(config, index)

    def write(draft: Path) -> None:
        (draft / MEMBERS).mkdir()
        for item in objects:
            (draft / MEMBERS / f"{item.name}.txt").write_text(_text(item), encoding="utf-8")

    make_folder_atomically(out / name, write)
    return name


def _text(item: ScannedObject) -> str:
    rows = np.hstack([item.xyz, item.rgb]).ravel().tolist()
    return ("%.3f %.3f %.3f %d %d %d\n" * len(item.xyz)) % tuple(rows)
