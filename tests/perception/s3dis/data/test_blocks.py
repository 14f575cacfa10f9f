"""Rooms cut into blocks: against plain loops, by hand, and that no point is lost."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.s3dis.data.blocks import (
    Block,
    BlockConfig,
    BlockSample,
    RoomFrame,
    cover_room,
    draw_sample,
    find_blocks,
    point_features,
    split_block,
)
from perception.s3dis.data.room import Room

TWIN = runpy.run_path(str(Path(__file__).parents[3] / "reference" / "s3dis_twin.py"))


def cloud(extent: tuple[float, float, float], count: int, seed: int = 31) -> np.ndarray:
    """Return points of a box somewhere in the building, its corners included."""
    rng = np.random.default_rng(seed)
    points = np.vstack([np.zeros(3), np.array(extent), rng.uniform(0, extent, (count, 3))])
    return (points + np.array([7.25, -3.5, 0.25])).astype(np.float32)


@settings(max_examples=60, deadline=None)
@given(
    extent=st.tuples(*[st.floats(0, 3.2)] * 2),
    stride=st.sampled_from([0.3, 0.5, 1.0]),
    cover=st.booleans(),
    seed=st.integers(0, 99),
)
def test_blocks_are_those_of_plain_loops(extent: tuple[float, float], stride: float, cover: bool, seed: int) -> None:
    xyz = cloud((*extent, 2.5), 60, seed)
    config = BlockConfig(stride=stride, min_points=12)
    expected = TWIN["find_blocks"](xyz.astype(np.float64), 1.0, stride, 12, cover)
    found = find_blocks(xyz, config, cover)
    assert [block.point_idx.tolist() for block in found] == [inside for _, _, inside in expected]
    centres = np.array([block.centre for block in found]).reshape(-1, 2)
    np.testing.assert_allclose(centres, np.array([[x + 0.5, y + 0.5] for x, y, _ in expected]).reshape(-1, 2))


def test_a_room_of_2_by_1_metres_has_three_blocks_in_a_row() -> None:
    blocks = find_blocks(cloud((2, 1, 2.5), 2000), BlockConfig())
    np.testing.assert_allclose([block.centre for block in blocks], [[0.5, 0.5], [1.0, 0.5], [1.5, 0.5]])


def test_every_other_row_goes_backwards() -> None:
    blocks = find_blocks(cloud((1.5, 1.5, 2.5), 2000), BlockConfig())
    np.testing.assert_allclose([block.centre for block in blocks], [[0.5, 0.5], [0.5, 1.0], [1.0, 1.0], [1.0, 0.5]])


def test_a_room_narrower_than_the_stride_has_a_block() -> None:
    (block,) = find_blocks(cloud((0.3, 0.2, 2.5), 200), BlockConfig())
    assert len(block.point_idx) == 202


def test_a_sparse_block_is_kept_only_where_a_point_is_in_no_other() -> None:
    corner = np.array([[3.0, 0.0, 0.0]])  # 101 points within a metre of the origin, one 3 m away
    xyz = np.vstack([cloud((0.9, 0.9, 1), 99) - np.array([7.25, -3.5, 0.25]), corner]).astype(np.float32)
    config = BlockConfig()
    assert sum(101 in block.point_idx for block in find_blocks(xyz, config)) == 0
    assert sum(101 in block.point_idx for block in find_blocks(xyz, config, cover=True)) == 1


@pytest.mark.parametrize("count", [5, 130, 4000])
def test_samples_hold_every_point_of_a_room(count: int) -> None:
    xyz = cloud((1.7, 1.2, 2.5), count)
    config = BlockConfig(points=256)
    samples = list(cover_room(xyz, config, np.random.default_rng(31)))
    assert {len(sample.point_idx) for sample in samples} == {256}
    seen = np.unique(np.concatenate([sample.point_idx for sample in samples]))
    assert seen.tolist() == list(range(count + 2))
    again = list(cover_room(xyz, config, np.random.default_rng(31)))
    assert all((a.point_idx == b.point_idx).all() for a, b in zip(samples, again, strict=True))
    other = list(cover_room(xyz, config, np.random.default_rng(32)))
    assert any((a.point_idx != b.point_idx).any() for a, b in zip(samples, other, strict=True))


@pytest.mark.parametrize(("count", "samples"), [(1, 1), (99, 1), (100, 1), (101, 2), (200, 2), (250, 3)])
def test_a_block_is_shared_out_once_and_filled_up_with_others(count: int, samples: int) -> None:
    block = Block(np.array([0.5, 0.5]), 3 * np.arange(count))
    shared = split_block(block, 100, np.random.default_rng(31))
    assert len(shared) == samples
    for sample in shared:
        distinct = sample.point_idx[: sample.distinct]
        assert len(np.unique(distinct)) == sample.distinct == min(count, 100)
        assert np.isin(sample.point_idx[sample.distinct :], distinct).all()
    first_of_each = np.concatenate([sample.point_idx[: sample.distinct] for sample in shared])[:count]
    assert sorted(first_of_each.tolist()) == block.point_idx.tolist()


@pytest.mark.parametrize("count", [40, 400])
def test_a_sample_to_train_on_repeats_only_where_points_are_few(count: int) -> None:
    block = Block(np.array([0.5, 0.5]), np.arange(count))
    sample = draw_sample(block, 100, np.random.default_rng(31))
    assert len(sample.point_idx) == 100
    assert len(np.unique(sample.point_idx)) == sample.distinct == min(count, 100)


def three_points() -> Room:
    return Room(
        name="Area_1/office_1",
        xyz=np.array([[10, 20, 30], [12, 24, 33], [11, 21, 31.5]], np.float32),
        rgb=np.array([[0, 0, 0], [255, 255, 255], [255, 51, 0]], np.uint8),
        semantic=np.zeros(3, np.uint8),
        instance=np.zeros(3, np.int32),
    )


def test_the_nine_dimensions_of_a_point_by_hand() -> None:
    room = three_points()
    frame = RoomFrame.of(room.xyz)
    np.testing.assert_array_equal(frame.low, [10, 20, 30])
    np.testing.assert_array_equal(frame.extent, [2, 4, 3])
    sample = BlockSample(np.array([0.75, 1.25]), np.array([2, 0]), 2)
    found = point_features(room, frame, sample)
    expected = [[0.25, -0.25, 1.5, 1, 0.2, 0, 0.5, 0.25, 0.5], [-0.75, -1.25, 0, 0, 0, 0, 0, 0, 0]]
    np.testing.assert_allclose(found, expected, atol=1e-7)
    assert found.dtype == np.float32
    np.testing.assert_allclose(point_features(room, frame, sample, colour=False), np.delete(expected, (3, 4, 5), 1))


def test_a_flat_room_has_finite_features() -> None:
    room = three_points()
    flat = Room(
        name=room.name,
        xyz=room.xyz * np.array([1, 1, 0], np.float32),
        rgb=room.rgb,
        semantic=room.semantic,
        instance=room.instance,
    )
    sample = BlockSample(np.zeros(2), np.arange(3), 3)
    assert point_features(flat, RoomFrame.of(flat.xyz), sample)[:, 8].tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stride": 0.0}, "stride must be positive and at most size, got 0.0 and 1.0"),
        ({"stride": 1.5}, "stride must be positive and at most size, got 1.5 and 1.0"),
        ({"points": 0}, "points and min_points must be at least 1, got 0 and 100"),
        ({"min_points": 0}, "points and min_points must be at least 1, got 4096 and 0"),
    ],
)
def test_nonsense_is_rejected(changes: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        BlockConfig(**changes)  # type: ignore[arg-type]


def test_points_must_be_three_dimensional() -> None:
    with pytest.raises(ValueError, match=r"xyz must be \(N, 3\), got \(4, 2\)"):
        find_blocks(np.zeros((4, 2), np.float32), BlockConfig())
