"""Training samples of rooms: from the blocks, with the truth that goes with them, the same bits again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from perception.s3dis.data.blocks import BlockConfig, find_blocks
from perception.s3dis.data.categories import CATEGORIES
from perception.s3dis.data.dataset import BlockBatches, PackedRoom, load_packed_rooms
from perception.s3dis.data.room import room_path
from perception.s3dis.presets import row_training
from perception.segmentation.networks.grid_net import GridNetConfig
from perception.segmentation.training.augment import AugmentConfig
from tests.perception.s3dis.s3dis_tree import told_by_colour_room

ROOMS = [PackedRoom.pack(told_by_colour_room(seed, f"Area_{seed}/office_1")) for seed in (1, 2)]
CONFIG = replace(row_training("dgcnn-new-colour", "small"), batch=3, points=64)


def test_a_packed_room_has_the_blocks_of_the_room() -> None:
    packed, blocks = ROOMS[0], find_blocks(ROOMS[0].room.xyz, BlockConfig())
    assert len(packed) == len(blocks) > 3
    for k, block in enumerate(blocks):
        assert np.array_equal(packed.block(k).centre, block.centre)
        assert np.array_equal(packed.block(k).point_idx, block.point_idx)
        assert packed.block(k).point_idx.dtype == np.int64


@pytest.mark.parametrize(("row", "channels"), [("dgcnn-new-colour", 9), ("dgcnn-new", 6)])
def test_samples_carry_their_points_truth(row: str, channels: int) -> None:
    config = replace(row_training(row, "small"), batch=3, points=64)
    batch = BlockBatches.of(config, ROOMS)(5)
    assert batch.inputs.shape == (3, 64, channels)
    assert batch.inputs.dtype == torch.float32
    assert torch.equal(batch.points_BN3, batch.inputs[..., :3])
    assert batch.offsets_BN3 is None
    assert batch.class_ids_BN.dtype == batch.instance_ids_BN.dtype == torch.int64
    assert len(batch.class_ids_BN.unique()) > 1
    if channels == 9:  # the colour of these rooms tells instance and category
        assert torch.equal((batch.inputs[..., 3] * 255).round().long(), batch.instance_ids_BN)
        assert torch.equal((batch.inputs[..., 4] * 255).round().long(), batch.class_ids_BN)
    assert batch.points_BN3[..., :2].abs().max() <= 0.5 + 1e-5  # from the middle of a block of 1 m


def test_a_step_gives_the_same_bits_and_another_step_seed_or_process_others() -> None:
    batches = BlockBatches.of(CONFIG, ROOMS)
    for first, second in zip(batches(3), batches(3), strict=True):
        assert first is second is None or torch.equal(first, second)
    others = (batches(4), replace_seed(batches, seed=1)(3), replace_seed(batches, rank=1)(3))
    assert not any(torch.equal(batches(3).inputs, other.inputs) for other in others)


def replace_seed(batches: BlockBatches, **changes: int) -> BlockBatches:
    return replace(batches, **changes)


def test_an_epoch_is_as_many_samples_as_there_are_blocks_and_all_rooms_are_drawn() -> None:
    batches = BlockBatches.of(replace(CONFIG, batch=200), ROOMS)
    assert len(batches.scenes) == len(ROOMS[0]) + len(ROOMS[1])
    numbers = [len(np.unique(packed.room.instance)) for packed in ROOMS]
    assert numbers[0] != numbers[1]
    assert batches(0).instance_ids_BN.max() == max(numbers) - 1


def test_other_rooms_are_another_digest() -> None:
    digests = {BlockBatches.of(CONFIG, rooms).digest() for rooms in (ROOMS, ROOMS[:1], ROOMS[::-1])}
    digests.add(
        BlockBatches.of(CONFIG, [replace(ROOMS[0], room=replace(ROOMS[0].room, source="x")), ROOMS[1]]).digest()
    )
    assert len(digests) == 4


def test_rooms_are_read_of_files(tmp_path: Path) -> None:
    path = room_path(tmp_path, "Area_1/office_1")
    ROOMS[0].room.save(path)
    (packed,) = load_packed_rooms([path])
    assert len(packed) == len(ROOMS[0])
    with pytest.raises(ValueError, match="none of 1 rooms has a block of enough points to learn from"):
        load_packed_rooms([path], BlockConfig(min_points=10**6))


def test_what_rooms_cannot_be_trained_with_is_named() -> None:
    with pytest.raises(ValueError, match="rooms are trained on without augmentation, got AugmentConfig"):
        BlockBatches.of(replace(CONFIG, augment=AugmentConfig()), ROOMS)
    with pytest.raises(ValueError, match="sees 9 coordinates of a point, or 6 without colour, got None"):
        BlockBatches.of(replace(CONFIG, network=GridNetConfig()), ROOMS)
    with pytest.raises(ValueError, match="sees 9 coordinates of a point, or 6 without colour, got 3"):
        BlockBatches.of(replace(CONFIG, network=replace(CONFIG.network, in_channels=3)), ROOMS)


def test_categories_fit_the_networks_classes() -> None:
    assert CONFIG.network.num_classes == len(CATEGORIES) == 13
