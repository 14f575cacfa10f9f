"""Grouping: against its naive twin, in any order of the points, on scenes whose groups are known, and at its limits."""

import re
import runpy
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import pdist

from perception.segmentation.grouping import similarity as grouping
from perception.segmentation.grouping.group_merging import GroupMergingConfig, merge_groups
from perception.segmentation.grouping.similarity import (
    EXTENT_TOLERANCE,
    group_points,
    half_sphere,
    propagate_labels,
)
from perception.segmentation.networks.distance import squared_threshold
from tests.perception.segmentation.grouping.grouped_scene import D_MAX, bad, blobs, same_partition

# Small scenes: groups of less than what counts in a bin.
GroupingConfig = partial(grouping.GroupingConfig, threshold=7.5, min_points=30, refinements=2)


TWIN = runpy.run_path(str(Path(__file__).parents[3] / "reference" / "grouping_twin.py"))
seeds = st.integers(0, 2**32 - 1)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.mark.slow
@pytest.mark.parametrize("leftovers", ["nearest", "none"])
@pytest.mark.parametrize("mask", [True, False])
@given(seed=seeds)
@settings(max_examples=8, deadline=None)
def test_grouping_equals_its_naive_twin(seed, mask, leftovers):
    rng = np.random.default_rng(seed)
    noise = rng.uniform(0.5, 6.0)  # from clear blobs to one cloud
    embedding, confidence, points, _ = blobs(rng, count=int(rng.integers(1, 90)), width=3, apart=8.0, noise=noise)
    refinements, least = int(rng.integers(0, 3)), int(rng.integers(1, 9))
    config = GroupingConfig(
        threshold=5.0, d_max=mask, slack=0.05, min_points=least, refinements=refinements, leftovers=leftovers
    )
    groups = group_points(embedding, confidence, points, D_MAX, config)
    expected = TWIN["group_points"](
        embedding,
        confidence,
        points,
        limit=25.0,
        reach=D_MAX * 1.05 if mask else np.inf,
        directions=half_sphere(96).T,
        refinements=refinements,
        min_points=least,
        nearest=leftovers == "nearest",
    )
    np.testing.assert_array_equal(groups.labels, expected)
    np.testing.assert_allclose(
        groups.scores, [confidence[expected == k].mean() for k in range(expected.max() + 1)], rtol=1e-12
    )


@given(seed=seeds, tied=st.booleans(), copies=st.booleans())
@settings(max_examples=25, deadline=None)
def test_grouping_does_not_depend_on_the_order_of_the_points(seed, tied, copies):
    rng = np.random.default_rng(seed)
    embedding, confidence, points, _ = blobs(rng, apart=8.0, noise=4.0)
    if tied:
        confidence = np.round(confidence, 1)
    if copies:
        points = np.repeat(points[::2], 2, axis=0)
    config = GroupingConfig(threshold=5.0, min_points=5)
    groups = group_points(embedding, confidence, points, D_MAX, config)
    order = rng.permutation(len(points))
    shuffled = group_points(embedding[order], confidence[order], points[order], D_MAX, config)
    np.testing.assert_array_equal(shuffled.labels, groups.labels[order])
    np.testing.assert_array_equal(shuffled.scores, groups.scores)


def test_grouping_twice_gives_the_same_and_leaves_its_arguments_alone(rng):
    scene = blobs(rng, noise=5.0)[:3]
    kept = [array.copy() for array in scene]
    first, second = (group_points(*scene, D_MAX, GroupingConfig(min_points=5)) for _ in range(2))
    np.testing.assert_array_equal(first.labels, second.labels)
    for array, before in zip(scene, kept, strict=True):
        np.testing.assert_array_equal(array, before)


@pytest.mark.parametrize("mask", [True, False])
@pytest.mark.parametrize("width", [3, 8, 35])
def test_separate_blobs_are_found_exactly(rng, mask, width):
    embedding, confidence, points, labels = blobs(rng, parts=3, width=width)
    groups = group_points(embedding, confidence, points, D_MAX, GroupingConfig(d_max=mask))
    assert same_partition(groups.labels, labels)
    for k in range(3):
        assert groups.scores[k] == pytest.approx(confidence[groups.labels == k].mean())


def test_votes_for_the_centre_serve_as_embedding(rng):
    _, confidence, points, labels = blobs(rng, parts=3)
    points = points + np.array([[0.0, 0, 0], [0.2, 0, 0], [0, 0.2, 0]])[labels]
    centres = np.stack([points[labels == k].mean(axis=0) for k in range(3)])
    votes = centres[labels] + rng.normal(size=points.shape) * 0.002
    config = GroupingConfig(threshold=0.3, min_points=20)
    assert same_partition(group_points(votes / D_MAX, confidence, points, D_MAX, config).labels, labels)


def two_far_apart(rng, distance):
    points = rng.uniform(-0.02, 0.02, (120, 3))
    points[60:, 0] += distance
    return np.zeros((120, 4), np.float32), rng.uniform(size=120), points


def test_mask_splits_two_parts_of_one_embedding_that_are_far_apart(rng):
    scene = two_far_apart(rng, 0.15)
    sides = np.repeat([0, 1], 60)
    assert same_partition(group_points(*scene, D_MAX, GroupingConfig()).labels, sides)
    assert len(group_points(*scene, D_MAX, GroupingConfig(d_max=False)).scores) == 1
    assert len(group_points(*scene, np.inf, GroupingConfig()).scores) == 1


@given(seed=seeds, slack=st.sampled_from([0.0, 0.02, 0.5]))
@settings(max_examples=25, deadline=None)
def test_no_group_is_wider_than_d_max(seed, slack):
    rng = np.random.default_rng(seed)
    points = rng.uniform(0.0, 0.3, (300, 3))
    embedding = rng.normal(size=(300, 2)) * rng.choice([0.0, 1.0, 5.0])
    config = GroupingConfig(slack=slack, min_points=3)
    groups = group_points(embedding, rng.uniform(size=300), points, D_MAX, config)
    widest = [pdist(points[groups.labels == k]).max() for k in range(len(groups.scores))]
    assert max(widest) <= D_MAX * (1 + slack) * (1 + EXTENT_TOLERANCE)
    assert max(widest) > 0.5 * D_MAX


def test_whole_parts_of_extent_d_max_are_never_trimmed(rng):
    rod = rng.normal(size=3)
    points = np.linspace(-0.5, 0.5, 200)[:, None] * rod / np.linalg.norm(rod) * D_MAX
    groups = group_points(np.zeros((200, 2)), rng.uniform(size=200), points, D_MAX, GroupingConfig())
    assert (groups.labels == 0).all()


def test_every_direction_is_near_one_of_those_that_bound_an_extent(rng):
    directions = half_sphere(96)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=0), 1.0)
    u = rng.normal(size=(100_000, 3))
    cosines = np.abs(u @ directions).max(axis=1) / np.linalg.norm(u, axis=1)
    assert cosines.min() * (1 + EXTENT_TOLERANCE) > 1.0


def outlier_scene(rng):
    """Return two groups on x and one point between them in the embedding, nearer to the first."""
    embedding = np.zeros((81, 1))
    embedding[40:80] = 100.0
    embedding[80] = 40.0
    return embedding, rng.uniform(size=81), rng.uniform(0, 0.05, (81, 3))


def test_left_over_points_go_to_the_nearest_mean_or_to_none(rng):
    scene = outlier_scene(rng)
    nearest = group_points(*scene, D_MAX, GroupingConfig())
    assert nearest.labels[80] == nearest.labels[0] != nearest.labels[40]
    alone = group_points(*scene, D_MAX, GroupingConfig(leftovers="none"))
    assert alone.labels[80] == -1
    np.testing.assert_array_equal(alone.labels[:80], nearest.labels[:80])


def test_left_over_point_out_of_reach_of_every_group_stays_alone(rng):
    embedding, confidence, points = outlier_scene(rng)
    points[80] += 1.0
    assert group_points(embedding, confidence, points, D_MAX, GroupingConfig()).labels[80] == -1
    assert group_points(embedding, confidence, points, D_MAX, GroupingConfig(d_max=False)).labels[80] >= 0


def test_small_groups_are_dissolved(rng):
    embedding, confidence, points, labels = blobs(rng, parts=3)
    few = np.flatnonzero(labels == 0)[:9]
    kept = np.append(few, np.flatnonzero(labels > 0))
    scene = embedding[kept], confidence[kept], points[kept]
    assert len(group_points(*scene, np.inf, GroupingConfig(min_points=9)).scores) == 3
    without = group_points(*scene, np.inf, GroupingConfig(min_points=10))
    assert len(without.scores) == 2
    assert (without.labels >= 0).all()
    alone = group_points(*scene, np.inf, GroupingConfig(min_points=10, leftovers="none"))
    assert (alone.labels[:9] == -1).all()


def test_group_that_loses_its_points_to_others_is_dissolved():
    # The seed 0 takes both 0.9; then 1 and 1 are a group, to whose mean the 0.9 are nearer than to their own, 0.6.
    embedding = np.array([[0.0], [0.9], [0.9], [1.0], [1.0]])
    confidence = np.array([1.0, 0.5, 0.5, 0.4, 0.2])
    config = {"threshold": 1.0, "refinements": 0, "min_points": 2}
    alone = group_points(embedding, confidence, np.zeros((5, 3)), D_MAX, GroupingConfig(**config, leftovers="none"))
    np.testing.assert_array_equal(alone.labels, [-1, 0, 0, 0, 0])
    np.testing.assert_allclose(alone.scores, [0.4])
    nearest = group_points(embedding, confidence, np.zeros((5, 3)), D_MAX, GroupingConfig(**config))
    np.testing.assert_array_equal(nearest.labels, np.zeros(5))


def test_unconfident_points_start_no_group(rng):
    embedding, _, points, labels = blobs(rng, parts=3)
    confidence = np.where(labels == 0, 0.3, 0.6)
    groups = group_points(embedding, confidence, points, np.inf, GroupingConfig(min_confidence=0.5, leftovers="none"))
    assert same_partition(groups.labels, np.where(labels == 0, -1, labels))


def test_seeds_are_tried_up_to_a_number(rng):
    embedding, confidence, points, _ = blobs(rng, parts=5)
    groups = group_points(embedding, confidence, points, np.inf, GroupingConfig(max_seeds=2))
    assert len(groups.scores) == 2


def test_refining_moves_a_proposal_to_where_the_points_are():
    # The only seed, 3, sees the three 0 but not the thirty -1; the mean of what it sees does.
    embedding = np.repeat([[3.0], [0.0], [-1.0]], [1, 3, 30], axis=0)
    confidence = np.append(1.0, np.full(33, 0.5))
    config = {"threshold": 3.5, "min_points": 5, "min_confidence": 0.9, "leftovers": "none"}
    seen = group_points(embedding, confidence, np.zeros((34, 3)), D_MAX, GroupingConfig(**config, refinements=1))
    np.testing.assert_array_equal(seen.labels, np.repeat([-1, 0], [1, 33]))
    unseen = group_points(embedding, confidence, np.zeros((34, 3)), D_MAX, GroupingConfig(**config, refinements=0))
    assert len(unseen.scores) == 0


def test_scaled_square_is_ten_times_the_square(rng):
    assert squared_threshold(7.5, "l2") == 56.25
    assert squared_threshold(7.5, "scaled_square") == 0.75
    embedding, confidence, points, labels = blobs(rng, parts=3)
    scaled = GroupingConfig(distance="scaled_square")
    groups = group_points(embedding / 10, confidence, points, np.inf, scaled)
    assert same_partition(groups.labels, labels)
    assert len(group_points(embedding / 10, confidence, points, np.inf, GroupingConfig()).scores) == 1


@pytest.mark.parametrize("count", [0, 1, 3])
def test_clouds_too_small_for_a_group_have_none(count):
    points = np.zeros((count, 3))
    groups = group_points(np.zeros((count, 5)), np.ones(count), points, D_MAX, GroupingConfig())
    np.testing.assert_array_equal(groups.labels, np.full(count, -1))
    assert groups.scores.shape == (0,)


def test_equal_points_are_one_group():
    groups = group_points(np.ones((500, 4)), np.full(500, 0.5), np.ones((500, 3)), D_MAX, GroupingConfig())
    assert (groups.labels == 0).all()
    np.testing.assert_array_equal(groups.scores, [0.5])


def test_eighty_thousand_points_in_thirty_parts(rng):
    embedding, confidence, points, labels = blobs(rng, parts=30, count=80_000, width=32)
    groups = group_points(embedding, confidence, points, D_MAX, GroupingConfig())
    assert same_partition(groups.labels, labels)


@pytest.mark.parametrize(("group", "config"), [(group_points, GroupingConfig()), (merge_groups, GroupMergingConfig())])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": np.zeros((40, 2))}, "points must be (N, 3), got (40, 2)"),
        ({"embedding": np.zeros((39, 4))}, "embedding must be (40, N), got (39, 4)"),
        ({"embedding": np.zeros((40, 0))}, "embedding must have at least one dimension, got (40, 0)"),
        ({"confidence": np.zeros((40, 1))}, "confidence must be (40,), got (40, 1)"),
        ({"points": bad((7, 1), (40, 3), np.nan)}, "points must be finite, point 7 is [0.0, nan, 0.0]"),
        ({"embedding": bad((3, 0), (40, 2), np.inf)}, "embedding must be finite, point 3 is [inf, 0.0]"),
        ({"confidence": bad(5, 40, np.nan)}, "confidence must be finite, point 5 is nan"),
        ({"confidence": bad(5, 40, 1.5)}, "confidence must be in [0, 1], got 0.0 to 1.5"),
        ({"confidence": bad(5, 40, -0.5)}, "confidence must be in [0, 1], got -0.5 to 0.0"),
        ({"d_max": 0.0}, "d_max must be positive, got 0.0"),
        ({"d_max": -1.0}, "d_max must be positive, got -1.0"),
        ({"d_max": np.nan}, "d_max must be positive, got nan"),
    ],
)
def test_bad_input_is_named(change, message, group, config):
    scene = {"embedding": np.zeros((40, 4)), "confidence": np.zeros(40), "points": np.zeros((40, 3)), "d_max": D_MAX}
    with pytest.raises(ValueError, match=re.escape(message)):
        group(**(scene | change), config=config)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"threshold": 0.0}, "threshold must be positive and finite, got 0.0"),
        ({"threshold": np.inf}, "threshold must be positive and finite, got inf"),
        ({"distance": "cosine"}, "distance must be 'l2' or 'scaled_square', got 'cosine'"),
        ({"slack": -0.1}, "slack must be 0 or more and finite, got -0.1"),
        ({"leftovers": "similar"}, "leftovers must be 'nearest' or 'none', got 'similar'"),
        ({"min_confidence": 2.0}, "min_confidence must be in [0, 1], got 2.0"),
        ({"min_points": 0}, "min_points must be 1 or more, got 0"),
        ({"refinements": -1}, "refinements must be 0 or more, got -1"),
        ({"max_seeds": 0}, "max_seeds must be 1 or more, got 0"),
    ],
)
def test_nonsense_settings_are_named(change, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        GroupingConfig(**change)


def test_labels_spread_from_a_subset_to_the_nearest_points():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 0, 0], [0.1, 0, 0]])
    labels = propagate_labels(points, np.array([0, 2]), np.array([7, -1]))
    np.testing.assert_array_equal(labels[[0, 2, 3, 4]], [7, -1, -1, 7])
    labels = propagate_labels(points, np.array([0, 2]), np.array([7, 3]), max_distance=1.5)
    np.testing.assert_array_equal(labels[[0, 2, 3, 4]], [7, 3, -1, 7])


def test_labelled_points_keep_their_label_even_among_copies():
    labels = propagate_labels(np.zeros((4, 3)), np.array([2, 0, 1]), np.array([5, 6, 7]))
    np.testing.assert_array_equal(labels[:3], [6, 7, 5])
    assert labels[3] in (5, 6, 7)


def test_an_empty_subset_labels_nothing():
    none = np.zeros(0, np.int64)
    np.testing.assert_array_equal(propagate_labels(np.zeros((2, 3)), none, none), [-1, -1])
    assert len(propagate_labels(np.zeros((0, 3)), none, none)) == 0


@pytest.mark.parametrize(
    ("points", "idx", "labels", "distance", "message"),
    [
        (np.zeros((4, 2)), [0], [1], 1.0, "points must be (N, 3), got (4, 2)"),
        (np.full((4, 3), np.nan), [0], [1], 1.0, "points must be finite, point 0 is [nan, nan, nan]"),
        (np.zeros((4, 3)), [[0]], [1], 1.0, "subset_idx must be (N,), got (1, 1)"),
        (np.zeros((4, 3)), [0, 1], [1], 1.0, "subset_labels must be (2,), got (1,)"),
        (np.zeros((4, 3)), [0, 4], [1, 1], 1.0, "subset_idx must be in [0, 4), got 0 to 4"),
        (np.zeros((4, 3)), [-1], [1], 1.0, "subset_idx must be in [0, 4), got -1 to -1"),
        (np.zeros((4, 3)), [0], [1], -1.0, "max_distance must be 0 or more, got -1.0"),
    ],
)
def test_spreading_nonsense_is_refused(points, idx, labels, distance, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        propagate_labels(points, np.array(idx), np.array(labels), distance)
