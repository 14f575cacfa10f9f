"""Training samples from labelled rooms, a pure function of rooms, seed and step."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from perception.geometry import Floats
from perception.s3dis.data.blocks import Block, BlockConfig, RoomFrame, draw_sample, find_blocks, point_features
from perception.s3dis.data.room import Room
from perception.segmentation.training.augment import NONE
from perception.segmentation.training.dataset import Batch
from perception.segmentation.training.presets import TrainingConfig

COLOURED, COLOURLESS = 9, 6  # number of input features of a point with and without colour


@dataclass(frozen=True, eq=False, kw_only=True)
class PackedRoom:
    """A room of N points divided into B blocks. Blocks overlap, and have K points in all.

    Attributes:
        room: Points and truth.
        frame: Position and extent of the room.
        centres: (B, 2) x and y of the centres of the blocks in the room frame [m].
        point_idx: (K,) int32 indices into the points of the room, block after block.
        starts: (B + 1,) index of the first point of each block in ``point_idx``.
    """

    room: Room
    frame: RoomFrame
    centres: Floats
    point_idx: NDArray[np.int32]
    starts: NDArray[np.int64]

    @classmethod
    def pack(cls, room: Room, config: BlockConfig | None = None) -> "PackedRoom":
        """Return a room divided into blocks for training; blocks of too few points are left out."""
        blocks = find_blocks(room.xyz, config or BlockConfig())
        return cls(
            room=room,
            frame=RoomFrame.of(room.xyz),
            centres=np.array([block.centre for block in blocks]).reshape(-1, 2),
            point_idx=np.concatenate([np.empty(0, np.int32), *(block.point_idx.astype(np.int32) for block in blocks)]),
            starts=np.cumsum([0, *(len(block.point_idx) for block in blocks)]),
        )

    def __len__(self) -> int:
        return len(self.centres)

    def block(self, k: int) -> Block:
        """Return block ``k``."""
        return Block(self.centres[k], self.point_idx[self.starts[k] : self.starts[k + 1]].astype(np.int64))


def load_packed_rooms(paths: Sequence[Path], config: BlockConfig | None = None) -> list[PackedRoom]:
    """Read rooms into memory, about 40 bytes a point: 8 GB for the five areas of S3DIS that are trained on.

    Raises:
        RoomError: A file does not hold a complete room.
        ValueError: No room has a block to learn from.
    """
    packed = [PackedRoom.pack(Room.load(path), config) for path in paths]
    if not any(len(room) for room in packed):
        raise ValueError(f"none of {len(paths)} rooms has a block of enough points to learn from")
    return packed


@dataclass(frozen=True, eq=False, kw_only=True)
class BlockBatches:
    """Source of batches from rooms in memory; all blocks are equally probable.

    Attributes:
        rooms: Rooms to draw from.
        batch: Number of samples in a batch.
        points: Number of points in a sample.
        colour: Whether the network sees colour.
        seed: Seed of everything that is drawn.
        rank: Index of this process among those that train together.
    """

    rooms: Sequence[PackedRoom]
    batch: int
    points: int
    colour: bool
    seed: int
    rank: int = 0

    @classmethod
    def of(cls, config: TrainingConfig, rooms: Sequence[PackedRoom], rank: int = 0) -> "BlockBatches":
        """Return the source of batches of a training.

        Raises:
            ValueError: The network does not take points of rooms, or augmentation is asked for.
        """
        if config.augment != NONE:
            raise ValueError(f"rooms are trained on without augmentation, got {config.augment}")
        return cls(
            rooms=rooms,
            batch=config.batch,
            points=config.points,
            colour=sees_colour(config.network),
            seed=config.seed,
            rank=rank,
        )

    @cached_property
    def scenes(self) -> Sequence[tuple[PackedRoom, int]]:
        """The blocks of all rooms, as pairs of a room and an index."""
        return [(room, k) for room in self.rooms for k in range(len(room))]

    def digest(self) -> str:
        """Return a SHA-256 over names, sources and numbers of blocks of the rooms, in order."""
        facts = "\n".join(f"{room.room.name} {room.room.source} {len(room)}" for room in self.rooms)
        return hashlib.sha256(facts.encode()).hexdigest()

    def __call__(self, step: int) -> Batch:
        """Return the batch of ``step``, which is the same at every call. Its points are in metres."""
        rng = np.random.default_rng(np.random.SeedSequence([self.seed, self.rank, step]))
        features, ids, classes = [], [], []
        for index in rng.integers(len(self.scenes), size=self.batch):
            packed, k = self.scenes[index]
            sample = draw_sample(packed.block(k), self.points, rng)
            features.append(point_features(packed.room, packed.frame, sample, self.colour))
            ids.append(packed.room.instance[sample.point_idx].astype(np.int64))
            classes.append(packed.room.semantic[sample.point_idx].astype(np.int64))
        inputs = torch.from_numpy(np.stack(features))
        return Batch(
            inputs=inputs,
            points_BN3=inputs[..., :3],
            instance_ids_BN=torch.from_numpy(np.stack(ids)),
            class_ids_BN=torch.from_numpy(np.stack(classes)),
        )


def sees_colour(network: object) -> bool:
    """Return whether a network, given by its configuration, sees colour.

    Raises:
        ValueError: The network does not take points of rooms.
    """
    channels: int | None = getattr(network, "in_channels", None)
    if channels not in (COLOURED, COLOURLESS):
        raise ValueError(
            f"a network of rooms sees {COLOURED} coordinates of a point, or {COLOURLESS} without colour, got {channels}"
        )
    return channels == COLOURED
