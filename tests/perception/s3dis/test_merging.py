"""BlockMerging on blocks made by hand, against plain loops, and each repaired fault."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.s3dis.data.categories import CATEGORIES
from perception.s3dis.merging import BlockMerger, MergeConfig, SampleGroups

TWIN = runpy.run_path(str(Path(__file__).parents[2] / "reference" / "s3dis_twin.py"))
WALL, CHAIR, BOARD = (CATEGORIES.index(name) for name in ("wall", "chair", "board"))
RELEASED = MergeConfig(exclusive=False, rejoin=False)


def row(count: int, spacing: float = 0.1) -> np.ndarray:
    """Return points along x, each in a cell of its own."""
    return np.column_stack([spacing * np.arange(count), np.zeros(count), np.zeros(count)]).astype(np.float32)


def sample(point_idx: object, groups: object, categories: object = CHAIR, confidences: object = 1.0) -> SampleGroups:
    idx = np.asarray(point_idx, np.int64)
    return SampleGroups(
        point_idx=idx,
        groups=np.broadcast_to(np.asarray(groups, np.int64), idx.shape),
        categories=np.broadcast_to(np.asarray(categories, np.int64), idx.shape),
        confidences=np.broadcast_to(np.asarray(confidences, float), idx.shape),
    )


def merged(xyz: np.ndarray, samples: list[SampleGroups], config: MergeConfig | None = None) -> list[int]:
    merger = BlockMerger(xyz, config)
    for each in samples:
        merger.add(each)
    labels: list[int] = merger.labels.tolist()
    return labels


def test_overlapping_blocks_go_on_with_their_object_whatever_its_number() -> None:
    """Two objects of 60 points; the second block sees the end of the first and numbers them the other way round."""
    first = sample(np.arange(60), 0)
    second = sample(np.arange(40, 120), np.r_[np.full(20, 1), np.full(60, 0)])
    assert merged(row(120), [first, second]) == [0] * 60 + [1] * 60


def test_blocks_that_do_not_overlap_begin_new_objects_also_after_object_0() -> None:
    assert merged(row(80), [sample(np.arange(40), 0), sample(np.arange(40, 80), 0)]) == [0] * 40 + [1] * 40


def test_hits_count_in_the_same_category_only() -> None:
    samples = [sample(np.arange(40), 0, CHAIR), sample(np.arange(40), 0, WALL)]
    merger = BlockMerger(row(40))
    for each in samples:
        merger.add(each)
    assert merger.labels.tolist() == [0] * 40  # a point keeps the first object that it is given
    assert [instance.label for instance in merger.instances()] == [CHAIR]


@pytest.mark.parametrize(("hits", "number"), [(7, 1), (6, 2)])
def test_seven_hits_go_on_six_do_not(hits: int, number: int) -> None:
    samples = [sample(np.arange(40), 0), sample(np.arange(40 - hits, 80), 0)]
    assert len(set(merged(row(80), samples))) == number


@pytest.mark.parametrize(("points", "label"), [(31, 0), (30, -1)])
def test_a_small_group_without_hits_is_dropped_and_not_object_0(points: int, label: int) -> None:
    assert merged(row(points), [sample(np.arange(points), 0)]) == [label] * points
    first = sample(np.arange(points, points + 50), 0)
    labels = merged(row(points + 50), [first, sample(np.arange(points), 0)])
    assert labels[:points] == [1 if label == 0 else -1] * points
    assert labels[points:] == [0] * 50


def test_a_small_group_with_hits_goes_on() -> None:
    assert merged(row(45), [sample(np.arange(40), 0), sample(np.arange(30, 45), 0)]) == [0] * 45


def test_points_without_a_group_stay_without_until_a_later_block() -> None:
    first = sample(np.arange(60), np.r_[np.full(40, 0), np.full(20, -1)])
    assert merged(row(60), [first]) == [0] * 40 + [-1] * 20
    assert merged(row(60), [first, sample(np.arange(20, 60), 0)]) == [0] * 60
    assert merged(row(60), [sample(np.arange(60), -1)]) == [-1] * 60


def test_more_than_300_objects_and_100_groups_of_a_block_fit() -> None:
    """The released code's arrays held 300 and 100, its stored ids 256."""
    count, each = 400, 31
    labels = merged(row(count * each, 0.04), [sample(np.arange(count * each), np.repeat(np.arange(count), each))])
    assert labels == np.repeat(np.arange(count), each).tolist()


def test_a_board_within_the_cells_of_its_wall_is_not_forgotten() -> None:
    """Point 2 i is of the wall, point 2 i + 1 of the board 1 cm before it."""
    place = np.repeat(row(60), 2, axis=0) + np.array([0.005, 0.005, 0.005], np.float32)
    place[1::2, 1] += 0.01
    category = np.tile([WALL, BOARD], 60)
    blocks = [np.arange(80), np.arange(40, 120)]
    labels = merged(place, [sample(idx, category[idx] == BOARD, category[idx]) for idx in blocks])
    assert labels == [0, 1] * 60


def test_touching_objects_of_a_category_stay_two_unlike_in_the_released_code() -> None:
    """The second chair is first seen in the second block, with 8 points in cells of the first one's."""
    xyz = np.vstack([row(40), row(8) + np.array([0.01, 0, 0], np.float32), row(40) + np.array([10, 0, 0], np.float32)])
    samples = [sample(np.arange(40), 0), sample(np.arange(88), np.r_[np.full(40, 0), np.full(48, 1)])]
    assert merged(xyz, samples) == [0] * 40 + [1] * 48
    assert merged(xyz, samples, RELEASED) == [0] * 88


def test_what_was_begun_at_two_ends_is_one_in_the_end_unlike_in_the_released_code() -> None:
    ends = [sample(np.arange(40), 0), sample(np.arange(60, 100), 0)]
    bridge = sample(np.arange(20, 75), 0)
    assert merged(row(100), [*ends, bridge]) == [0] * 100
    assert merged(row(100), [*ends, bridge], RELEASED) == [0] * 60 + [1] * 40
    two = sample(np.arange(100), np.r_[np.full(50, 0), np.full(50, 1)])  # tells the ends apart, with more points
    assert merged(row(100), [*ends, bridge, two]) == [0] * 60 + [1] * 40


def test_support_counts_the_smaller_side() -> None:
    """40 points speak for one object; of 60 and 30 that are told apart, 30 speak against."""
    ends = [sample(np.arange(60), 0), sample(np.arange(60, 160), 0)]
    bridge = sample(np.r_[np.arange(20, 60), np.arange(60, 120)], 0)
    two = sample(np.r_[np.arange(60), np.arange(130, 160)], np.r_[np.full(60, 0), np.full(30, 1)])
    assert merged(row(160), [*ends, bridge, two]) == [0] * 160
    assert merged(row(160), [*ends, bridge, two, two]) == [0] * 60 + [1] * 100


def test_support_is_summed_before_the_next_pair_is_fused() -> None:
    """B and C are one, A and C might be; but A and B are known to be two, so A stays alone."""
    a, b, c = np.arange(40), np.arange(40, 80), np.arange(80, 120)
    samples = [
        sample(np.r_[a, b], np.r_[np.full(40, 0), np.full(40, 1)]),
        sample(c, 0),
        sample(np.r_[b[:30], c[:30]], 0),
        sample(np.r_[a[:10], c[30:40]], 0),
    ]
    assert merged(row(120), samples) == [0] * 40 + [1] * 80


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 10**6), exclusive=st.booleans(), rejoin=st.booleans(), min_points=st.integers(0, 6))
def test_labels_are_those_of_plain_loops(seed: int, exclusive: bool, rejoin: bool, min_points: int) -> None:
    rng = np.random.default_rng(seed)
    xyz = rng.uniform(0, [0.5, 0.5, 0.2], (120, 3)).astype(np.float32)
    samples = []
    for _ in range(int(rng.integers(1, 7))):
        idx = rng.choice(120, int(rng.integers(5, 60)), replace=False)
        groups, categories = rng.integers(-1, 5, len(idx)), rng.integers(7, 9, len(idx))
        if rng.random() < 0.7:
            groups, categories = (xyz[idx, 0] * 6 + rng.uniform()).astype(int), 7 + (xyz[idx, 1] > 0.25)
        samples.append(sample(idx, groups, categories))
    config = MergeConfig(cell=0.06, min_hits=3, min_points=min_points, exclusive=exclusive, rejoin=rejoin)
    plain = [(each.point_idx.tolist(), each.groups.tolist(), each.categories.tolist()) for each in samples]
    expected = TWIN["merge"](
        xyz.astype(np.float64), plain, cell=0.06, min_hits=3, min_points=min_points, exclusive=exclusive, rejoin=rejoin
    )
    assert merged(xyz, samples, config) == expected


def test_class_is_the_mode_and_confidence_the_mean_over_all_samples() -> None:
    merger = BlockMerger(row(60))
    merger.add(sample(np.arange(40), 0, CHAIR, 0.5))
    mixed = np.r_[np.full(25, CHAIR), np.full(15, WALL)]  # the group is of chairs: most of its points are
    merger.add(sample(np.arange(20, 60), 0, mixed, 0.9))
    (found,) = merger.instances()
    assert found.label == CHAIR
    assert found.score == pytest.approx((40 * 0.5 + 40 * 0.9) / 80)
    assert found.point_idx.tolist() == list(range(60))


def test_instances_come_best_first_and_small_ones_of_a_category_go() -> None:
    merger = BlockMerger(row(140))
    merger.add(sample(np.arange(50), 0, WALL, 0.2))
    merger.add(sample(np.arange(50, 90), 0, CHAIR, 0.8))
    merger.add(sample(np.arange(90, 140), 0, CHAIR, 0.5))
    assert [instance.score for instance in merger.instances()] == pytest.approx([0.8, 0.5, 0.2])
    least = np.zeros(len(CATEGORIES))
    least[CHAIR] = 41
    kept = merger.instances(least)
    assert [(len(instance.point_idx), instance.label) for instance in kept] == [(50, CHAIR), (50, WALL)]


def test_an_empty_room_of_groups_has_no_instances() -> None:
    assert BlockMerger(row(10)).instances() == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cell": 0.0}, "cell must be positive, got 0.0"),
        ({"min_hits": 0}, "min_hits must be at least 1 and min_points 0 or more, got 0 and 30"),
        ({"min_points": -1}, "min_hits must be at least 1 and min_points 0 or more, got 7 and -1"),
    ],
)
def test_nonsense_is_rejected(changes: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MergeConfig(**changes)  # type: ignore[arg-type]


def test_a_sample_must_fit() -> None:
    with pytest.raises(ValueError, match="point_idx of a sample must not repeat"):
        sample([1, 2, 1], 0)
    with pytest.raises(ValueError, match="categories must be 0 to 12, got 0 to 13"):
        sample([1, 2], 0, 13)
    with pytest.raises(ValueError, match=r"groups must be \(2,\), got \(3,\)"):
        SampleGroups(
            point_idx=np.arange(2), groups=np.zeros(3, int), categories=np.zeros(2, int), confidences=np.zeros(2)
        )
    with pytest.raises(ValueError, match=r"min_sizes must be \(13,\), got \(12,\)"):
        BlockMerger(row(3)).instances(np.zeros(12))
    with pytest.raises(ValueError, match=r"xyz must be \(N, 3\), got \(3,\)"):
        BlockMerger(np.zeros(3, np.float32))
