"""Training samples out of labelled scenes: a pure function of (scenes, seed, step)."""

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
from perception.segmentation.networks.grid import FINE, place_in, view_grid
from perception.segmentation.networks.grid_net import GridInputs
from perception.segmentation.networks.inputs import centred
from perception.segmentation.scene import SCENES_NOTE, BoundaryScene, SceneError
from perception.segmentation.training.augment import AugmentConfig, draw_kept, draw_turn
from perception.segmentation.training.presets import TrainingConfig

_log = logging.getLogger(__name__)
CROP = 128  # coarse cells along a side of a training crop
BORDER = 4  # cells at a crop's rim whose points are not learned from: their parts are cut

Singles = NDArray[np.float32]


class Batch(NamedTuple):
    """Samples and their truth.

    Attributes:
        inputs: Of the network: points (B, N, 3) in units of d_max, or :class:`GridInputs`.
        points_BN3: The points in units of d_max, camera axes.
        instance_ids_BN: -1 for the container and for filling.
        offsets_BN3: From each point to its part's centre, in units of d_max; None where they are not taught.
        class_ids_BN: Semantic classes; None for the single class of a bin of parts.
    """

    inputs: Tensor | GridInputs
    points_BN3: Tensor
    instance_ids_BN: Tensor
    offsets_BN3: Tensor | None = None
    class_ids_BN: Tensor | None = None


class BatchSource(Protocol):
    """What a training takes its batches from: parts in bins here, rooms in :mod:`perception.s3dis.data.dataset`."""

    @property
    def scenes(self) -> Sequence[object]:
        """Return what samples are drawn of; an epoch draws as many."""

    @property
    def rank(self) -> int:
        """Return which of the processes that train together this is."""

    def digest(self) -> str:
        """Return what tells these scenes from others."""

    def __call__(self, step: int) -> Batch:
        """Return the batch of ``step``: the same bits at every call."""


@dataclass(frozen=True, eq=False)
class PackedScene:
    """What training needs of a :class:`BoundaryScene` of N points and P parts, in little memory.

    Attributes:
        name: Folder and name of its file; "" if it has none.
        surface: (h, w) depth of the fine cells [m], 0 for none.
        place_fine: (N, 2) column and row of each point in fine cells.
        points: (N, 3) camera frame [m].
        instance_ids: (N,) part of each point, -1 for the container.
        centres: (P, 3) camera frame [m].
        d_max: The part's largest extent [m].
    """

    name: str
    surface: Singles
    place_fine: Singles
    points: Singles
    instance_ids: NDArray[np.int16]
    centres: Singles
    d_max: float

    @classmethod
    def pack(cls, scene: BoundaryScene, name: str = "") -> "PackedScene":
        """Drop what training does not read."""
        return cls(
            name=name,
            surface=scene.surface.depth.astype(np.float32),
            place_fine=place_in(scene.surface, scene.boundary.pixels).astype(np.float32),
            points=scene.boundary.points_cam.astype(np.float32),
            instance_ids=scene.instance_ids.astype(np.int16),
            centres=scene.centres_cam.astype(np.float32),
            d_max=scene.d_max,
        )


def load_packed(paths: Sequence[Path], progress: Callable[[], object] | None = None) -> list[PackedScene]:
    """Read scenes into memory, about 0.9 MB each; a damaged file is left out with a warning.

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
        FileNotFoundError: A folder holds none.
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
    """Return the files to train and to validate on.

    Args:
        folders: To train on.
        validation: Folders to validate on; without any, the first scenes of each of ``folders`` are kept for it.
        held_out: How many, at most half of a folder; the first, so that they stay the same when a folder grows.

    Raises:
        FileNotFoundError: A folder holds no scenes.
    """
    if validation:
        return find_scenes(folders), find_scenes(validation)
    each = [find_scenes([folder]) for folder in folders]
    kept = [min(held_out, len(paths) // 2) for paths in each]
    training = [path for paths, n in zip(each, kept, strict=True) for path in paths[n:]]
    return training, [path for paths, n in zip(each, kept, strict=True) for path in paths[:n]]


def scene_sources(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """Return for each folder of ``paths`` what its note says (part, seed, sensor ...) and how many scenes are used."""
    sources: list[dict[str, Any]] = []
    for folder in dict.fromkeys(path.parent for path in paths):
        try:
            note = json.loads((folder / SCENES_NOTE).read_text())
        except (OSError, ValueError):
            note = {}  # scenes of another maker
        known = {name: note.get(name) for name in ("part", "seed", "sensor", "num_parts", "jitter")}
        sources.append({**known, "scenes": sum(path.parent == folder for path in paths)})
    return sources


class GridSample(NamedTuple):
    """One crop of N points; cells, place and local are :class:`perception.segmentation.networks.grid.GridView`'s.

    Attributes:
        cells: (CHANNELS, CROP, CROP).
        place: (N, 2).
        local: (N, LOCAL).
        points: (N, 3) turned camera axes, about the crop's focus, in units of d_max.
        instance_ids: (N,) -1 for the container.
        offsets: (N, 3) to the parts' centres, axes and unit of ``points``.
    """

    cells: Singles
    place: Singles
    local: Singles
    points: Singles
    instance_ids: NDArray[np.int64]
    offsets: Singles


def grid_sample(scene: PackedScene, count: int, augment: AugmentConfig, rng: np.random.Generator) -> GridSample:
    """Cut a turned window out of a scene around one of its points, and draw ``count`` of the points in it.

    Points may repeat where there are fewer.
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
    """Return each point's chance to be drawn: an instance's share grows with the root of its size.

    Average precision counts a part that is hardly seen as much as one that lies free.
    """
    sizes = np.bincount(instance_ids + 1)
    chances = 1.0 / np.sqrt(sizes[instance_ids + 1])
    normed: Floats = chances / chances.sum()
    return normed


def _warped(surface: Singles, turn: Floats, middle: Floats, side: int) -> Singles:
    """Return the (side, side) window of the surface around ``middle``, turned, sampled at the nearest cell."""
    inverse = np.linalg.inv(turn)
    shift = middle - 0.5 + inverse @ np.full(2, 0.5 - side / 2)
    matrix = np.column_stack([inverse, shift])
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(surface, matrix, (side, side), flags=flags), np.float32)


class CloudSample(NamedTuple):
    """A subset of N points of a whole scene; shapes, axes and units are those of :class:`GridSample`."""

    points: Singles
    instance_ids: NDArray[np.int64]
    offsets: Singles


def cloud_sample(scene: PackedScene, count: int, augment: AugmentConfig, rng: np.random.Generator) -> CloudSample:
    """Draw ``count`` points of a whole scene, as the paper's networks are fed; points may repeat if there are fewer."""
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
    """Makes the batch of any step out of scenes in memory.

    Attributes:
        scenes: To draw from.
        kind: Crops for the image-plane network, or subsets of whole clouds.
        batch: Samples of a step.
        points: Points of a sample.
        augment: How much they vary.
        seed: Of everything that is drawn.
        rank: Of this process among several that train together.
    """

    scenes: Sequence[PackedScene]
    kind: Literal["grid", "cloud"]
    batch: int
    points: int
    augment: AugmentConfig
    seed: int
    rank: int = 0

    @classmethod
    def of(cls, config: TrainingConfig, scenes: Sequence[PackedScene], rank: int = 0) -> "BatchMaker":
        """Return what makes the batches of a training."""
        return cls(
            scenes=scenes,
            kind=config.kind,
            batch=config.batch,
            points=config.points,
            augment=config.augment,
            seed=config.seed,
            rank=rank,
        )

    def digest(self) -> str:
        """Return a SHA-256 over the names of the scenes, in order: other scenes are another training."""
        return hashlib.sha256("\n".join(scene.name for scene in self.scenes).encode()).hexdigest()

    def __call__(self, step: int) -> Batch:
        """Return the batch of ``step``: the same bits at every call."""
        rng = np.random.default_rng(np.random.SeedSequence([self.seed, self.rank, step]))
        chosen = [self.scenes[k] for k in rng.integers(len(self.scenes), size=self.batch)]
        if self.kind == "cloud":
            clouds = [cloud_sample(scene, self.points, self.augment, rng) for scene in chosen]
            points, ids, offsets = (torch.from_numpy(np.stack(arrays)) for arrays in zip(*clouds, strict=True))
            return Batch(inputs=points, points_BN3=points, instance_ids_BN=ids, offsets_BN3=offsets)
        crops = [grid_sample(scene, self.points, self.augment, rng) for scene in chosen]
        cells, place, local, points, ids, offsets = (
            torch.from_numpy(np.stack(arrays)) for arrays in zip(*crops, strict=True)
        )
        inputs = GridInputs(cells_BCHW=cells, place_BN2=place, local_BNL=local, points_BN3=points)
        return Batch(inputs=inputs, points_BN3=points, instance_ids_BN=ids, offsets_BN3=offsets)
