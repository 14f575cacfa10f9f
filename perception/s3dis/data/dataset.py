"""Training samples out of labelled rooms: a pure function of (rooms, seed, step)."""

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

COLOURED, COLOURLESS = 9, 6  # coordinates of a point with colour and without


@dataclass(frozen=True, eq=False, kw_only=True)
class PackedRoom:
    """A room of N points cut into B blocks, K points in all, as points are in several.

    Attributes:
        room: The points and the truth.
        frame: Where it lies.
        centres: (B, 2) x and y of the blocks' middles, room's frame [m].
        point_idx: (K,) int32 indices into the room's points, block after block.
        starts: (B + 1,) where each block begins among them.
    """

    room: Room
    frame: RoomFrame
    centres: Floats
    point_idx: NDArray[np.int32]
    starts: NDArray[np.int64]

    @classmethod
    def pack(cls, room: Room, config: BlockConfig | None = None) -> "PackedRoom":
        """Cut a room as the blocks of a training are; one without a whole block has none."""
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
        RoomError: A file holds no whole room.
        ValueError: No room has a block to learn from.
    """
    packed = [PackedRoom.pack(Room.load(path), config) for path in paths]
    if not any(len(room) for room in packed):
        raise ValueError(f"none of {len(paths)} rooms has a block of enough points to learn from")
    return packed


@dataclass(frozen=True, eq=False, kw_only=True)
class BlockBatches:
    """Makes the batch of any step out of rooms in memory; every block is as likely as any other.

    Attributes:
        rooms: To draw from.
        batch: Samples of a step.
        points: Points of a sample.
        colour: Whether the network sees it.
        seed: Of everything that is drawn.
        rank: Of this process among several that train together.
    """

    rooms: Sequence[PackedRoom]
    batch: int
    points: int
    colour: bool
    seed: int
    rank: int = 0

    @classmethod
    def of(cls, config: TrainingConfig, rooms: Sequence[PackedRoom], rank: int = 0) -> "BlockBatches":
        """Return what makes the batches of a training.

        Raises:
            ValueError: Its network is not one over points, or it asks for variations that rooms do not have.
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
        """Return the blocks, each as its room and its number there."""
        return [(room, k) for room in self.rooms for k in range(len(room))]

    def digest(self) -> str:
        """Return a SHA-256 over names, sources and numbers of blocks of the rooms, in order."""
        facts = "\n".join(f"{room.room.name} {room.room.source} {len(room)}" for room in self.rooms)
        return hashlib.sha256(facts.encode()).hexdigest()

    def __call__(self, step: int) -> Batch:
        """Return the batch of ``step``: the same bits at every call. Its points are in metres."""
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
    """Return whether a network, told by its config, is one of rooms with colour, or of those without.

    Raises:
        ValueError: It is neither.
    """
    channels: int | None = getattr(network, "in_channels", None)
    if channels not in (COLOURED, COLOURLESS):
        raise ValueError(
            f"a network of rooms sees {COLOURED} coordinates of a point, or {COLOURLESS} without colour, got {channels}"
        )
    return channels == COLOURED
