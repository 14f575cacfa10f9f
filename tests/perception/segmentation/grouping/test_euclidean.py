"""Connected components: against flooding, at exact distances, of clouds of every size."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.instance import labels_of
from perception.segmentation.grouping.euclidean import euclidean_components
from tests.perception.segmentation.grouping.grouped_scene import bad, same_partition

TWIN = runpy.run_path(str(Path(__file__).parents[3] / "reference" / "grouping_twin.py"))["components"]
seeds = st.integers(0, 2**32 - 1)


@pytest.mark.slow
@given(seed=seeds, radius=st.sampled_from([0.001, 0.02, 0.05, 0.1, 0.3, 5.0]), flat=st.booleans())
@settings(max_examples=40, deadline=None)
def test_components_equal_their_naive_twin(seed, radius, flat):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.0, 1.0, (120, 3)) * [0.4, 0.3, 0.0 if flat else 0.3]
    found = labels_of(euclidean_components(points, radius, 1), 120)
    assert same_partition(found, TWIN(points, radius))


def test_points_exactly_one_radius_apart_are_linked():
    points = np.arange(5)[:, None] * np.array([[0.25, 0.0, 0.0]])
    assert len(euclidean_components(points, 0.25, 1)) == 1
    assert len(euclidean_components(points, 0.2499, 1)) == 5


def test_components_are_scored_by_size_and_small_ones_left_out():
    points = np.repeat([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]], [5, 20, 10], axis=0)
    found = euclidean_components(points, 0.1, 6)
    assert [(len(one.point_idx), one.score) for one in found] == [(20, 1.0), (10, 0.5)]
    np.testing.assert_array_equal(found[1].point_idx, np.arange(25, 35))
    assert euclidean_components(points, 0.1, 21) == []


@pytest.mark.parametrize("radius", [1e-4, 0.005, 0.05, 10.0])
def test_components_of_eighty_thousand_points(radius):
    rng = np.random.default_rng(0)
    points = rng.uniform(0.0, 0.2, (80_000, 3))
    found = euclidean_components(np.append(points, points + 30.0, axis=0)[::2], radius, 1)
    assert sum(len(one.point_idx) for one in found) == 80_000


def test_components_of_few_points():
    assert euclidean_components(np.zeros((0, 3)), 0.1, 1) == []
    assert len(euclidean_components(np.zeros((3, 3)), 0.1, 3)) == 1


@pytest.mark.parametrize(
    ("points", "radius", "least", "message"),
    [
        (np.zeros((4, 2)), 0.1, 1, "points must be (N, 3), got (4, 2)"),
        (bad((1, 0), (4, 3), np.nan), 0.1, 1, "points must be finite, point 1 is [nan, 0.0, 0.0]"),
        (np.zeros((4, 3)), 0.0, 1, "radius must be positive and finite, got 0.0"),
        (np.zeros((4, 3)), np.inf, 1, "radius must be positive and finite, got inf"),
        (np.zeros((4, 3)), 0.1, 0, "min_points must be 1 or more, got 0"),
        (np.eye(3), 1e-9, 1, "radius 1e-09 is too small for a cloud of extent [1.0, 1.0, 1.0]"),
    ],
)
def test_components_of_nonsense_are_refused(points, radius, least, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        euclidean_components(points, radius, least)
