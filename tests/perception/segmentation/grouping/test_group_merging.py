"""SGPN's GroupMerging: against its naive twin over a whole similarity matrix, and in cases made by hand."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from perception.segmentation.grouping.group_merging import GroupMergingConfig, merge_groups
from tests.perception.segmentation.grouping.grouped_scene import D_MAX, blobs

TWIN = runpy.run_path(str(Path(__file__).parents[3] / "reference" / "grouping_twin.py"))["merge_groups"]
SMALL = {"threshold": 1.5, "min_proposal": 2, "min_points": 3}
seeds = st.integers(0, 2**32 - 1)


@given(seed=seeds)
@settings(max_examples=40, deadline=None)
def test_group_merging_equals_its_naive_twin(seed):
    rng = np.random.default_rng(seed)
    embedding, confidence, points, _ = blobs(rng, count=80, width=2, apart=6.0, noise=rng.uniform(0.5, 5.0))
    classes = rng.integers(0, rng.integers(1, 4), 80)
    d_max = rng.choice([None, D_MAX])
    least = int(rng.integers(1, 12))
    groups = merge_groups(
        embedding,
        confidence,
        points,
        GroupMergingConfig(threshold=20.0, distance="scaled_square", min_points=least),
        d_max=d_max,
        classes=classes,
    )
    S = 10 * cdist(embedding, embedding, "sqeuclidean")
    if d_max is not None:
        S[cdist(points, points) > d_max] = np.inf
    expected = TWIN(
        S, 20.0, confidence, classes, min_confidence=0.4, min_proposal=5, iou=0.6, share=0.8, min_points=least
    )
    np.testing.assert_array_equal(groups.labels, expected)
    means = [confidence[expected == k].mean() for k in range(expected.max() + 1)]
    np.testing.assert_allclose(groups.scores, means, rtol=1e-12)


def on_a_line(*places):
    """Return embedding, confidence and points of ``(place, count)`` in the order given."""
    embedding = np.concatenate([np.full((count, 1), float(place)) for place, count in places])
    return embedding, np.ones(len(embedding)), np.zeros((len(embedding), 3))


def test_group_merging_depends_on_the_order_of_the_points():
    # {0, 1} and {1, 2} share half of their points, so both stay, and the later one is painted over the first.
    embedding, confidence, points = on_a_line((0, 8), (1, 8), (2, 8))
    confidence[8:16] = 0.0
    config = GroupMergingConfig(**SMALL)
    np.testing.assert_array_equal(merge_groups(embedding, confidence, points, config).labels, np.repeat([0, 1, 1], 8))
    backwards = merge_groups(embedding[::-1], confidence, points, config).labels[::-1]
    np.testing.assert_array_equal(backwards, np.repeat([1, 1, 0], 8))


def test_larger_proposal_replaces_the_one_it_overlaps():
    # {0, 1} of 12 points is 12 / 14 of {0, 1, 2}, which takes its place; {1, 2} lies within that.
    embedding, confidence, points = on_a_line((0, 7), (1, 5), (2, 2))
    config = GroupMergingConfig(**SMALL, leftovers="none")
    np.testing.assert_array_equal(merge_groups(embedding, confidence, points, config).labels, np.zeros(14))
    # Without {0, 1, 2}: {1, 2} of 7 has 5 in {0, 1}, a share of 0.71 and an IoU of 0.36, and is a group of its own.
    confidence[7:12] = 0.0
    two = merge_groups(embedding, confidence, points, config)
    np.testing.assert_array_equal(two.labels, np.repeat([0, 1], 7))
    np.testing.assert_allclose(two.scores, [1.0, 2 / 7])


def test_smaller_proposal_within_an_older_one_is_merged_by_its_share():
    scene = on_a_line((1, 4), (0, 10), (2, 2))  # {1, 2} is all in {0, 1, 2}, with an IoU of 6 / 16
    np.testing.assert_array_equal(merge_groups(*scene, GroupMergingConfig(**SMALL)).labels, np.zeros(16))
    never = GroupMergingConfig(**SMALL, share=1.0)
    np.testing.assert_array_equal(merge_groups(*scene, never).labels, np.repeat([1, 0, 1], [4, 10, 2]))


def test_groups_that_others_are_painted_over_are_dropped():
    embedding, confidence, points = on_a_line((0, 2), (1, 8), (2, 8))
    confidence[2:10] = 0.0
    groups = merge_groups(embedding, confidence, points, GroupMergingConfig(**SMALL, leftovers="none"))
    np.testing.assert_array_equal(groups.labels, np.repeat([-1, 0], [2, 16]))


def test_only_proposals_of_more_than_the_least_number_are_painted():
    groups = merge_groups(*on_a_line((0, 3), (9, 4)), GroupMergingConfig(**SMALL))
    np.testing.assert_array_equal(groups.labels, np.repeat([-1, 0], [3, 4]))


def test_unconfident_points_propose_nothing():
    embedding, confidence, points = on_a_line((0, 10), (9, 10))
    confidence[10:] = 0.4
    groups = merge_groups(embedding, confidence, points, GroupMergingConfig(**SMALL))
    np.testing.assert_array_equal(groups.labels, np.repeat([0, -1], 10))
    np.testing.assert_array_equal(groups.scores, [1.0])


def test_class_without_proposals_is_one_group():
    embedding, confidence, points = on_a_line((0, 10), (9, 10))
    groups = merge_groups(embedding, confidence * 0.1, points, GroupMergingConfig(**SMALL))
    np.testing.assert_array_equal(groups.labels, np.zeros(20))


def test_proposals_stay_within_their_class_and_no_class_is_left_out():
    scene = on_a_line((0, 20))
    classes = np.repeat([1, 4, -1], [8, 8, 4])
    groups = merge_groups(*scene, GroupMergingConfig(**SMALL), classes=classes)
    np.testing.assert_array_equal(groups.labels, np.repeat([0, 1, -1], [8, 8, 4]))


def test_mask_keeps_far_points_out_of_a_proposal():
    embedding, confidence, points = on_a_line((0, 20))
    points[10:, 2] = 2 * D_MAX
    groups = merge_groups(embedding, confidence, points, GroupMergingConfig(**SMALL), d_max=D_MAX)
    np.testing.assert_array_equal(groups.labels, np.repeat([0, 1], 10))


def test_unassigned_points_follow_those_similar_to_them_one_after_the_other():
    # 2.2 is similar to 1, 3.4 to 2.2 alone, which was unassigned too and came first; 5.8 comes before 4.6.
    embedding, confidence, points = on_a_line((0, 10), (1, 5), (2.2, 1), (3.4, 1), (5.8, 1), (4.6, 1))
    confidence[10:] = 0.0
    groups = merge_groups(embedding, confidence, points, GroupMergingConfig(**SMALL))
    np.testing.assert_array_equal(groups.labels, np.repeat([0, -1, 0], [17, 1, 1]))


def test_unassigned_points_follow_the_nearest_in_space():
    embedding, confidence, points = on_a_line((0, 10), (9, 10), (5, 2))
    confidence[20:] = 0.0
    points[10:20], points[20:] = 1.0, 0.9
    alone = merge_groups(embedding, confidence, points, GroupMergingConfig(**SMALL, leftovers="none"))
    np.testing.assert_array_equal(alone.labels, np.repeat([0, 1, -1], [10, 10, 2]))
    near = GroupMergingConfig(**SMALL, leftovers="nearest")
    nearest = merge_groups(embedding, confidence, points, near)
    np.testing.assert_array_equal(nearest.labels, np.repeat([0, 1, 1], [10, 10, 2]))
    masked = merge_groups(embedding, confidence, points, near, d_max=D_MAX)
    np.testing.assert_array_equal(masked.labels, alone.labels)


def test_group_merging_of_nothing():
    groups = merge_groups(np.zeros((0, 4)), np.zeros(0), np.zeros((0, 3)), GroupMergingConfig())
    assert groups.labels.shape == groups.scores.shape == (0,)
    with pytest.raises(ValueError, match=re.escape("classes must be (0,), got (1,)")):
        merge_groups(np.zeros((0, 4)), np.zeros(0), np.zeros((0, 3)), GroupMergingConfig(), classes=np.zeros(1, int))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"threshold": -1.0}, "threshold must be positive and finite, got -1.0"),
        ({"distance": "cosine"}, "distance must be 'l2' or 'scaled_square', got 'cosine'"),
        ({"min_confidence": -1.0}, "min_confidence must be in [0, 1], got -1.0"),
        ({"iou": 1.1}, "iou must be in [0, 1], got 1.1"),
        ({"share": np.nan}, "share must be in [0, 1], got nan"),
        ({"min_proposal": -1}, "min_proposal must be 0 or more, got -1"),
        ({"min_points": 0}, "min_points must be 1 or more, got 0"),
        ({"neighbours": 0}, "neighbours must be 1 or more, got 0"),
        ({"leftovers": "x"}, "leftovers must be 'similar', 'nearest' or 'none', got 'x'"),
    ],
)
def test_nonsense_settings_are_named(change, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        GroupMergingConfig(**change)
