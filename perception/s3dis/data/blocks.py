"""Division of rooms into blocks of 1 m x 1 m, and of blocks into the samples that a network sees.

The room frame is the building frame, moved so that the least x, y and z of the room are 0 (as in the released code).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, require_shape
from perception.s3dis.data.room import Room

Ints = NDArray[np.int64]
Singles = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class BlockConfig:
    """Division of a room into blocks, with the constants of PointNet's and SGPN's code.

    Attributes:
        size: Side of a block [m].
        stride: Distance between neighbouring blocks [m].
        points: Number of points of a sample.
        min_points: Number of points of the smallest block.
    """

    size: float = 1.0
    stride: float = 0.5
    points: int = 4096
    min_points: int = 100

    def __post_init__(self) -> None:
        if not 0 < self.stride <= self.size:
            raise ValueError(f"stride must be positive and at most size, got {self.stride} and {self.size}")
        if self.points < 1 or self.min_points < 1:
            raise ValueError(f"points and min_points must be at least 1, got {self.points} and {self.min_points}")


class Block(NamedTuple):
    """A block of a room.

    Attributes:
        centre: (2,) x and y of its centre in the room frame [m].
        point_idx: (M,) ascending indices into the points of the room.
    """

    centre: Floats
    point_idx: Ints


class BlockSample(NamedTuple):
    """A sample of the points of a block, the input of a network.

    Attributes:
        centre: (2,) x and y of the centre of the block in the room frame [m].
        point_idx: (P,) indices into the points of the room.
        distinct: Number of leading points that are distinct. The others repeat them, where the block has too few.
    """

    centre: Floats
    point_idx: Ints
    distinct: int


@dataclass(frozen=True, eq=False, kw_only=True)
class RoomFrame:
    """Position and extent of a room.

    Attributes:
        low: (3,) least coordinates in the building frame [m].
        extent: (3,) greatest minus least coordinates [m].
    """

    low: Floats
    extent: Floats

    @classmethod
    def of(cls, xyz: Singles) -> "RoomFrame":
        """Return the frame of a room with (N, 3) points [m]."""
        low = xyz.min(axis=0).astype(np.float64)
        return cls(low=low, extent=xyz.max(axis=0) - low)


def find_blocks(xyz: Singles, config: BlockConfig, cover: bool = False) -> list[Block]:
    """Return the blocks of a room, row by row along y, every other row backwards as in the released code.

    Args:
        xyz: (N, 3) points in the building frame [m].
        config: Size, stride and smallest number of points.
        cover: Keep a block of too few points if one of them is in no other block, because every point counts at test.

    Note:
        Edges belong to both blocks. Unlike in the released code, a room narrower than the stride has a block.
    """
    require_shape("xyz", xyz, (None, 3))
    frame = RoomFrame.of(xyz)
    plan = xyz[:, :2] - frame.low[:2]
    rows, columns = np.maximum(np.ceil((frame.extent[:2] - config.size) / config.stride), 0).astype(int) + 1
    tiles = _Tiles(plan, config.stride)
    reach = int(config.size / config.stride + 1e-9)
    blocks = []
    for i in range(rows):
        for j in range(columns) if i % 2 == 0 else reversed(range(columns)):
            corner = np.array([i, j]) * config.stride
            near = tiles.between(i, i + reach, j, j + reach)
            inside = ((plan[near] >= corner) & (plan[near] <= corner + config.size)).all(axis=1)
            blocks.append(Block(corner + config.size / 2, np.sort(near[inside])))
    return _kept(blocks, len(xyz), config.min_points, cover)


class _Tiles:
    """The points of a floor plan, sorted by square tile."""

    def __init__(self, plan: Floats, side: float) -> None:
        tile = (plan / side).astype(np.int64)
        self._shape = tile.max(axis=0) + 1
        keys = tile[:, 0] * self._shape[1] + tile[:, 1]
        self._order = np.argsort(keys, kind="stable")
        self._starts = np.searchsorted(keys[self._order], np.arange(self._shape.prod() + 1))

    def between(self, i0: int, i1: int, j0: int, j1: int) -> Ints:
        """Return the points of tiles (i0, j0) to (i1, j1), both included."""
        last = min(j1, int(self._shape[1]) - 1)
        found = [
            self._order[self._starts[i * self._shape[1] + j0] : self._starts[i * self._shape[1] + last + 1]]
            for i in range(i0, min(i1, int(self._shape[0]) - 1) + 1)
            if j0 <= last
        ]
        return np.concatenate([np.empty(0, np.int64), *found])


def _kept(blocks: list[Block], points: int, least: int, cover: bool) -> list[Block]:
    covered = np.zeros(points, np.bool_)
    for block in blocks:
        if len(block.point_idx) >= least:
            covered[block.point_idx] = True
    kept = []
    for block in blocks:
        if len(block.point_idx) >= least or (cover and not covered[block.point_idx].all()):
            covered[block.point_idx] = True
            kept.append(block)
    return kept


def draw_sample(block: Block, points: int, rng: np.random.Generator) -> BlockSample:
    """Draw a sample of ``points`` points of a block; a smaller block gives all of its points and repeats some."""
    idx, count = block.point_idx, len(block.point_idx)
    if count >= points:
        return BlockSample(block.centre, idx[rng.choice(count, points, replace=False)], points)
    repeated = idx[rng.integers(count, size=points - count)]
    return BlockSample(block.centre, np.concatenate([idx, repeated]), count)


def split_block(block: Block, points: int, rng: np.random.Generator) -> list[BlockSample]:
    """Divide the points of a block into samples of ``points``; the last one is filled with others of the block."""
    count = len(block.point_idx)
    if count <= points:
        return [draw_sample(block, points, rng)]
    shuffled = block.point_idx[rng.permutation(count)]
    rest = count % points
    parts = [shuffled[first : first + points] for first in range(0, count - rest, points)]
    if rest:
        others = rng.choice(count - rest, points - rest, replace=False)
        parts.append(np.concatenate([shuffled[count - rest :], shuffled[others]]))
    return [BlockSample(block.centre, part, points) for part in parts]


def cover_room(xyz: Singles, config: BlockConfig, rng: np.random.Generator) -> Iterator[BlockSample]:
    """Yield samples, block by block, that contain every point of a room at least once."""
    for block in find_blocks(xyz, config, cover=True):
        yield from split_block(block, config.points, rng)


def point_features(room: Room, frame: RoomFrame, sample: BlockSample, colour: bool = True) -> Singles:
    """Return the (P, 9) input features of the points of a sample; (P, 6) without colour.

    The columns are x and y relative to the centre of the block and height above the lowest point of the room [m], red,
    green and blue in [0, 1], and the position in the room from 0 to 1 on each axis. Differs from the released code,
    which takes the centre of the block from the least coordinates of the sampled points, so it varies with the sample.
    """
    placed = room.xyz[sample.point_idx] - frame.low
    local = placed - np.append(sample.centre, 0.0)
    share = np.divide(placed, frame.extent, out=np.zeros_like(placed), where=frame.extent > 0)
    columns = [local, room.rgb[sample.point_idx] / 255.0, share] if colour else [local, share]
    return np.concatenate(columns, axis=1).astype(np.float32)
