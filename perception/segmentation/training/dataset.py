"""Training samples from labelled scenes, a pure function of scenes, seed and step."""

import hashlib
import json
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from perception.geometry import Floats
from perception.segmentation.networks.context_net import ContextInputs, ContextNetConfig
from perception.segmentation.networks.grid import FINE, view_grid
from perception.segmentation.networks.grid_net import GridInputs, shape_input
from perception.segmentation.networks.inputs import centred
from perception.segmentation.scene import SCENES_NOTE, BoundaryScene, SceneError
from perception.segmentation.training.augment import AugmentConfig, draw_kept, draw_turn
from perception.segmentation.training.context_samples import context_sample
from perception.segmentation.training.packed import PackedScene
from perception.segmentation.training.presets import TrainingConfig

_log = logging.getLogger(__name__)
CROP = 128  # side of a training crop [coarse cells]
HIDDEN = 0.4  # share of the crops whose network is not told the shape of the part, so that it can do without
BORDER = 4  # width of the border of a crop whose points are not drawn, as their parts are cut off [coarse cells]

Singles = NDArray[np.float32]


class Batch(NamedTuple):
    """A batch of samples and their truth.

    Attributes:
        inputs: Inputs of the network: (B, N, 3) points in units of d_max, or :class:`GridInputs`, or
            :class:`ContextInputs`.
        points_BN3: Points along the camera axes, in units of d_max.
        instance_ids_BN: Instance of each point, -1 for void (the container, padding).
        offsets_BN3: Offset from each point to the centre of its part, in units of d_max; None if they are not learned.
        class_ids_BN: Semantic class of each point; None for the single class of a bin of parts.
    """

    inputs: Tensor | GridInputs | ContextInputs
    points_BN3: Tensor
    instance_ids_BN: Tensor
    offsets_BN3: Tensor | None = None
    class_ids_BN: Tensor | None = None


class BatchSource(Protocol):
    """Source of batches: parts in bins here, rooms in :mod:`perception.s3dis.data.dataset`."""

    @property
    def scenes(self) -> Sequence[object]:
        """Return the scenes that samples are drawn from; an epoch draws as many samples."""

    @property
    def rank(self) -> int:
        """Return the index of this process among those that train together."""

    def digest(self) -> str:
        """Return a digest that identifies the scenes."""

    def __call__(self, step: int) -> Batch:
        """Return the batch of ``step``, which is the same at every call."""


def load_packed(paths: Sequence[Path], progress: Callable[[], object] | None = None) -> list[PackedScene]:
    """Read scenes into memory, about 0.9 MB each; a damaged file is left out with a warning.

    Args:
        paths: Scene files.
        progress: Called after each file.

    Raises:
        SceneError: No file holds a scene with boundary points.
    """
    scenes = []
    for path in paths:
        try:
            scene = PackedScene.pack(BoundaryScene.load(path), f"{path.parent.name}/{path.name}")
        except SceneError as error:
            _log.warning("left out: %s", error)
            continue
        finally:
            if progress is not None:
                progress()
        if (scene.instance_ids >= 0).any():
            scenes.append(scene)
    if not scenes:
        raise SceneError(
            f"none of {len(paths)} files holds a scene to learn from; make some with binpick generate-scenes"
        )
    return scenes


def find_scenes(folders: Sequence[Path]) -> list[Path]:
    """Return the scene files of folders, in order.

    Raises:
        FileNotFoundError: A folder holds no scenes.
    """
    found: list[Path] = []
    for folder in folders:
        paths = sorted(folder.glob("scene_*.npz"))
        if not paths:
            raise FileNotFoundError(
                f"{folder} holds no scene_*.npz; make them with binpick generate-scenes --out {folder}"
            )
        found += paths
    return found


def split_scenes(folders: Sequence[Path], validation: Sequence[Path], held_out: int) -> tuple[list[Path], list[Path]]:
    """Return the scene files to train on, and those to validate on.

    Args:
        folders: Folders of scenes to train on.
        validation: Folders of scenes to validate on. Without any, the first scenes of each of ``folders`` are held out.
        held_out: Number of scenes held out of each folder, at most half of it. They are the first ones, so that they
            stay the same when a folder grows.

    Raises:
        ValueError: ``held_out`` is negative.
        FileNotFoundError: A folder holds no scenes.
    """
    if held_out < 0:
        raise ValueError(f"held_out must not be negative, got {held_out}")
    if validation:
        return find_scenes(folders), find_scenes(validation)
    each = [find_scenes([folder]) for folder in folders]
    kept = [min(held_out, len(paths) // 2) for paths in each]
    training = [path for paths, n in zip(each, kept, strict=True) for path in paths[n:]]
    return training, [path for paths, n in zip(each, kept, strict=True) for path in paths[:n]]


def scene_sources(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """Return for each folder of scenes its settings (part, seed, sensor ...) and the number of scenes used."""
    sources: list[dict[str, Any]] = []
    for folder in dict.fromkeys(path.parent for path in paths):
        try:
            note = json.loads((folder / SCENES_NOTE).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            note = {}  # scenes that generate_scenes did not make
        known = {name: note.get(name) for name in ("part", "file", "seed", "sensor", "num_parts", "jitter")}
        sources.append({**known, "scenes": sum(path.parent == folder for path in paths)})
    return sources


class GridSample(NamedTuple):
    """A crop of a scene with N points; see :class:`perception.segmentation.networks.grid.GridView`.

    Attributes:
        cells: (CHANNELS, CROP, CROP) channels of the coarse cells.
        place: (N, 2) column and row of each point in coarse cells.
        local: (N, LOCAL) local features of each point.
        points: (N, 3) points relative to the focus of the crop, along the rotated camera axes, in units of d_max.
        instance_ids: (N,) part of each point, -1 for the container.
        offsets: (N, 3) offset from each point to the centre of its part, in the axes and unit of ``points``.
    """

    cells: Singles
    place: Singles
    local: Singles
    points: Singles
    instance_ids: NDArray[np.int64]
    offsets: Singles


def grid_sample(scene: PackedScene, count: int, augment: AugmentConfig, rng: np.random.Generator) -> GridSample:
    """Draw a rotated crop around one of the points of a scene, and ``count`` of the points in it.

    Points are repeated if there are fewer.

    Args:
        scene: Scene to draw from.
        count: Number of points of the sample.
        augment: Strength of the augmentation.
        rng: Source of the draws.
    """
    turn = draw_turn(augment, rng)
    stretch = 1.0 + rng.uniform(-augment.scale, augment.scale)
    side = CROP * FINE
    focus = rng.integers(len(scene.points))
    middle = scene.place_fine[focus] + rng.uniform(-side / 4, side / 4, size=2) / stretch
    surface = _warped(scene.surface, turn * stretch, middle, side)
    place = (scene.place_fine - middle) @ turn.T * stretch + side / 2
    seen = ((place > 0) & (place < side)).all(axis=1)
    chosen = np.nonzero(seen)[0]
    points, d_max = scene.points[chosen], scene.d_max / stretch
    depths = points[:, 2] + augment.jitter * scene.d_max * rng.standard_normal(len(chosen))
    kept = draw_kept(points, scene.d_max, augment, rng)
    reference = float(np.median(points[:, 2])) + rng.uniform(-0.2, 0.2) * scene.d_max
    view = view_grid(surface, place[chosen], depths, d_max, reference, kept)
    rim = FINE * BORDER
    taught = ((place[chosen] > rim) & (place[chosen] < side - rim)).all(axis=1) & kept
    pool = np.nonzero(taught if taught.any() else np.ones(len(chosen), bool))[0]
    drawn = rng.choice(pool, count, replace=len(pool) < count, p=_chances(scene.instance_ids[chosen[pool]]))
    scale = 1.0 / d_max
    ids = scene.instance_ids[chosen[drawn]].astype(np.int64)
    to_centre = (scene.centres[ids] - points[drawn]) * scale
    to_centre[:, :2] = to_centre[:, :2] @ turn.T
    turned = (points[drawn] - scene.points[focus]) * scale
    turned[:, :2] = turned[:, :2] @ turn.T
    return GridSample(
        cells=view.cells,
        place=view.place[drawn],
        local=view.local[drawn],
        points=turned.astype(np.float32),
        instance_ids=ids,
        offsets=to_centre.astype(np.float32),
    )


def _chances(instance_ids: NDArray[np.int16]) -> Floats:
    """Return the probability of each point to be drawn: an instance's share is proportional to the root of its size.

    Average precision counts a part that is mostly occluded as much as one that is fully visible.
    """
    sizes = np.bincount(instance_ids + 1)
    chances = 1.0 / np.sqrt(sizes[instance_ids + 1])
    normed: Floats = chances / chances.sum()
    return normed


def _warped(surface: Singles, turn: Floats, middle: Floats, side: int) -> Singles:
    """Return the (side, side) window of the surface around ``middle``, rotated and sampled at the nearest cell."""
    inverse = np.linalg.inv(turn)
    shift = middle - 0.5 + inverse @ np.full(2, 0.5 - side / 2)
    matrix = np.column_stack([inverse, shift])
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(surface, matrix, (side, side), flags=flags), np.float32)


class CloudSample(NamedTuple):
    """A random subset of the points of a scene; shapes, axes and units are those of :class:`GridSample`."""

    points: Singles
    instance_ids: NDArray[np.int64]
    offsets: Singles


def cloud_sample(scene: PackedScene, count: int, augment: AugmentConfig, rng: np.random.Generator) -> CloudSample:
    """Draw ``count`` points of a scene, the input of the paper's networks; points are repeated if there are fewer."""
    turn = draw_turn(augment, rng)
    unit = scene.d_max * (1.0 + rng.uniform(-augment.scale, augment.scale))
    kept = np.nonzero(draw_kept(scene.points, scene.d_max, augment, rng))[0]
    kept = kept if len(kept) else np.arange(len(scene.points))
    drawn = rng.choice(kept, count, replace=len(kept) < count)
    ids = scene.instance_ids[drawn].astype(np.int64)
    to_centre = (scene.centres[ids] - scene.points[drawn]) / unit
    points = centred(scene.points[drawn], unit)
    points[:, 2] += (augment.jitter * rng.standard_normal(count)).astype(np.float32)
    points[:, :2], to_centre[:, :2] = points[:, :2] @ turn.T, to_centre[:, :2] @ turn.T
    return CloudSample(points=points, instance_ids=ids, offsets=to_centre.astype(np.float32))


@dataclass(frozen=True, eq=False, kw_only=True)
class BatchMaker:
    """Source of batches from scenes in memory.

    Attributes:
        scenes: Scenes to draw from.
        kind: Kind of samples: crops for the image-plane or the context network, or subsets of clouds.
        batch: Number of samples in a batch.
        points: Number of points in a sample.
        augment: Strength of the augmentation.
        seed: Seed of everything that is drawn.
        rank: Index of this process among those that train together.
        context: Sizes of the context network, if the samples are for it.
    """

    scenes: Sequence[PackedScene]
    kind: Literal["grid", "cloud", "context"]
    batch: int
    points: int
    augment: AugmentConfig
    seed: int
    rank: int = 0
    context: ContextNetConfig | None = None

    @classmethod
    def of(cls, config: TrainingConfig, scenes: Sequence[PackedScene], rank: int = 0) -> "BatchMaker":
        """Return the source of batches of a training."""
        return cls(
            scenes=scenes,
            kind=config.kind,
            batch=config.batch,
            points=config.points,
            augment=config.augment,
            seed=config.seed,
            rank=rank,
            context=config.network if isinstance(config.network, ContextNetConfig) else None,
        )

    def digest(self) -> str:
        """Return a SHA-256 over the names of the scenes, in order."""
        return hashlib.sha256("\n".join(scene.name for scene in self.scenes).encode()).hexdigest()

    def __call__(self, step: int) -> Batch:
        """Return the batch of ``step``, which is the same at every call."""
        rng = np.random.default_rng(np.random.SeedSequence([self.seed, self.rank, step]))
        chosen = [self.scenes[k] for k in rng.integers(len(self.scenes), size=self.batch)]
        if self.kind == "cloud":
            clouds = [cloud_sample(scene, self.points, self.augment, rng) for scene in chosen]
            points, ids, offsets = (torch.from_numpy(np.stack(arrays)) for arrays in zip(*clouds, strict=True))
            return Batch(inputs=points, points_BN3=points, instance_ids_BN=ids, offsets_BN3=offsets)
        if self.context is not None:
            net = self.context
            drawn = [context_sample(scene, self.points, net.spacing, net.k, self.augment, rng) for scene in chosen]
            around = ContextInputs.of([sample.cloud for sample in drawn])
            ids, offsets = (torch.from_numpy(np.stack(arrays)) for arrays in list(zip(*drawn, strict=True))[1:])
            return Batch(inputs=around, points_BN3=around.points_BN3, instance_ids_BN=ids, offsets_BN3=offsets)
        crops = [grid_sample(scene, self.points, self.augment, rng) for scene in chosen]
        cells, place, local, points, ids, offsets = (
            torch.from_numpy(np.stack(arrays)) for arrays in zip(*crops, strict=True)
        )
        told = [None if rng.random() < HIDDEN else scene.shape for scene in chosen]
        shape = torch.from_numpy(np.stack([shape_input(values) for values in told]))
        inputs = GridInputs(cells_BCHW=cells, place_BN2=place, local_BNL=local, points_BN3=points, shape_BS=shape)
        return Batch(inputs=inputs, points_BN3=points, instance_ids_BN=ids, offsets_BN3=offsets)
