"""Instances and labels say the same thing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perception.instance import Instance, instances_of, labels_of


def instance(*points: int, score: float = 0.5) -> Instance:
    return Instance(point_idx=np.array(points, np.int64), score=score)


def test_labels_by_hand() -> None:
    labels = labels_of([instance(0, 3), instance(2)], 5)
    assert labels.tolist() == [0, -1, 1, 0, -1]
    assert labels.dtype == np.int64


def test_of_overlapping_instances_the_first_counts() -> None:
    assert labels_of([instance(1, 2), instance(0, 1, 2, 3)], 4).tolist() == [1, 0, 0, 1]


def test_no_instance_labels_nothing() -> None:
    assert labels_of([], 3).tolist() == [-1, -1, -1]
    assert labels_of([], 0).shape == (0,)
    assert instances_of(np.full(3, -1), []) == []
    assert instances_of(np.zeros(0, np.int64), [0.3]) == []


def test_instances_by_hand() -> None:
    found = instances_of(np.array([2, -1, 0, 2, 0]), [0.1, 0.8, 0.9])
    assert [one.point_idx.tolist() for one in found] == [[0, 3], [2, 4]]
    assert [one.score for one in found] == [0.9, 0.1]
    assert [one.label for one in found] == [0, 0]


def test_equal_scores_keep_the_order_of_the_labels() -> None:
    found = instances_of(np.array([1, 2, 0]), np.full(3, 0.5))
    assert [one.point_idx.tolist() for one in found] == [[2], [0], [1]]


@given(st.lists(st.integers(-1, 6), max_size=40), st.lists(st.integers(0, 3), min_size=7, max_size=7))
def test_instances_are_those_the_labels_name(values: list[int], scores: list[int]) -> None:
    labels = np.array(values, np.int64)
    found = instances_of(labels, np.array(scores, float))
    assert [one.score for one in found] == sorted((one.score for one in found), reverse=True)
    groups = {tuple(np.nonzero(labels == k)[0].tolist()): float(scores[k]) for k in set(values) - {-1}}
    assert {tuple(one.point_idx.tolist()): one.score for one in found} == groups
    np.testing.assert_array_equal(labels_of(found, len(labels)) < 0, labels < 0)


def test_nonsense_is_refused() -> None:
    with pytest.raises(ValueError, match=r"point_idx must be .*, got \(1, 2\)"):
        Instance(point_idx=np.zeros((1, 2), np.int64), score=0.5)
    for score in (np.nan, np.inf):
        with pytest.raises(ValueError, match=f"score must be finite, got {score}"):
            instance(0, score=score)
    with pytest.raises(ValueError, match="labels go up to 2, but there are 2 scores"):
        instances_of(np.array([0, 2]), [0.5, 0.5])
    with pytest.raises(ValueError, match=r"labels must be .*, got \(2, 1\)"):
        instances_of(np.zeros((2, 1), np.int64), [0.5])
