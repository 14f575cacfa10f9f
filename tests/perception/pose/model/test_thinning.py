"""Thinning: cases worked by hand, its naive twin, what any thinned cloud must satisfy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from perception.geometry import random_rotation
from perception.pose.model._thinning_kernels import keep_first
from perception.pose.model.pair_features import unit
from perception.pose.model.thinning import thin_points
from tests.reference import thinning_twin

X, Y = [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]
RIGHT = math.pi / 2


def line(*places):
    """Return points on the x axis."""
    return np.array(places, dtype=float)[:, None] * X


def cloud(rng, kind, count):
    """Return points and tangents, some without either: scattered, on a lattice of the radius, or along lines."""
    points, tangents = rng.uniform(-4, 4, (count, 3)) * rng.choice([0.1, 1.0, 3.0]), rng.normal(size=(count, 3))
    if kind == "lattice":  # distances and angles that are exactly the limits, equal points
        points, tangents = rng.integers(-3, 4, (count, 3)) * 0.5, rng.integers(-1, 2, (count, 3)).astype(float)
    elif kind == "lines":
        way = unit(rng.normal(size=(3, 3)))[rng.integers(0, 3, count)]
        points, tangents = way * rng.uniform(-9, 9, (count, 1)), way * rng.choice([-1.0, 2.5], (count, 1))
    blank = rng.random(count)
    tangents[blank < 0.05] = 0.0
    tangents[(blank > 0.05) & (blank < 0.08), 1] = np.nan
    points[blank > 0.96, rng.integers(0, 3)] = rng.choice([np.nan, np.inf, -np.inf])
    return points, tangents


def test_the_first_point_of_each_stretch_stays():
    points = line(0.0, 0.9, 1.0, 1.1, 2.0, 2.2, 7.0)
    # 1.1 is the first beyond 0 and hides 2.0, which lies within 1 of it.
    assert thin_points(points, np.tile(Y, (7, 1)), 1.0, 0.1).tolist() == [0, 3, 5, 6]


def test_a_point_that_was_left_out_hides_no_other():
    points = line(0.0, 0.8, 1.6, 2.4)
    assert thin_points(points, np.tile(X, (4, 1)), 1.0, 0.1).tolist() == [0, 2]


def test_the_order_of_the_points_decides():
    assert thin_points(line(0.8, 0.0, 1.6), np.tile(X, (3, 1)), 1.0, 0.1).tolist() == [0]
    assert thin_points(line(0.0, 0.8, 1.6), np.tile(X, (3, 1)), 1.0, 0.1).tolist() == [0, 2]


def test_points_exactly_at_the_radius_are_near():
    assert thin_points(line(0.0, 1.0), np.tile(X, (2, 1)), 1.0, 0.1).tolist() == [0]
    assert thin_points(line(0.0, np.nextafter(1.0, 2.0)), np.tile(X, (2, 1)), 1.0, 0.1).tolist() == [0, 1]


@pytest.mark.parametrize(("degrees", "kept"), [(0, 1), (29, 1), (31, 2), (90, 2), (149, 2), (151, 1), (180, 1)])
def test_edges_that_cross_keep_a_point_each(degrees, kept):
    turn = math.radians(degrees)
    tangents = np.array([X, [math.cos(turn), math.sin(turn), 0.0]])
    assert len(thin_points(np.zeros((2, 3)), tangents, 1.0, math.radians(30))) == kept


def test_a_tangents_length_does_not_matter():
    tangents = np.array([X, [0.0, 30.0, 0.0], [1e-3, 0.0, 0.0]])
    assert thin_points(np.zeros((3, 3)), tangents, 1.0, math.radians(30)).tolist() == [0, 1]


def test_an_angle_of_zero_merges_equal_lines_and_a_right_angle_any():
    rng = np.random.default_rng(0)
    way = rng.normal(size=(50, 3))
    tangents = np.concatenate([way, -3 * way])
    assert thin_points(np.zeros((100, 3)), tangents, 1.0, 0.0).tolist() == list(range(50))
    assert thin_points(np.zeros((3, 3)), np.eye(3), 1.0, RIGHT).tolist() == [0]


def test_points_without_a_direction_or_a_place_are_left_out_and_hide_no_other():
    points, tangents = line(0.0, 0.1, 0.2, 0.3), np.tile(X, (4, 1))
    points[1, 2], tangents[0], tangents[2, 0] = np.inf, 0.0, np.nan
    assert thin_points(points, tangents, 1.0, 0.1).tolist() == [3]


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from(["scattered", "lattice", "lines"]),
    radius=st.sampled_from([1e-6, 0.25, 0.5, 0.7, math.sqrt(0.5), 1.0, 3.0, 1e3]),
    angle=st.sampled_from([0.0, 0.3, math.pi / 4, 1.2, RIGHT]),
)
def test_the_points_that_stay_are_those_of_plain_loops(seed, kind, radius, angle):
    rng = np.random.default_rng(seed)
    points, tangents = cloud(rng, kind, int(rng.integers(0, 120)))
    assert thin_points(points, tangents, radius, angle).tolist() == thinning_twin.thin_points(
        points, tangents, radius, angle
    )


@pytest.mark.parametrize("shift", [0.0, 1e3, 1e9, -1e15, 1e200])
def test_far_from_the_origin_the_points_that_stay_are_still_those_of_plain_loops(shift):
    points, tangents = cloud(np.random.default_rng(1), "scattered", 150)
    points[:, 1] += shift
    kept = thin_points(points, tangents, 0.01, 1.0)
    assert kept.tolist() == thinning_twin.thin_points(points, tangents, 0.01, 1.0)


@pytest.mark.slow
def test_of_a_large_cloud_no_two_kept_points_are_alike_and_every_other_has_a_kept_one():
    rng = np.random.default_rng(2)
    way = unit(rng.normal(size=(40, 3)))
    which = np.arange(4000) % 40
    points = rng.uniform(-0.1, 0.1, (40, 3))[which] + way[which] * rng.uniform(-0.1, 0.1, (4000, 1))
    tangents = way[which]
    kept = thin_points(points, tangents, 0.003, 0.5)
    assert 300 < len(kept) < 3700
    assert (np.diff(kept) > 0).all()
    far = cdist(points, points[kept]) > 0.003
    unlike = np.abs(tangents @ tangents[kept].T) < math.cos(0.5)
    like = ~(far | unlike)
    assert like[kept].sum() == len(kept)  # itself
    assert np.array_equal(like.any(axis=1), np.ones(4000, bool))
    # The one that hides a point comes before it.
    assert (kept[np.argmax(like, axis=1)] <= np.arange(4000)).all()


def test_a_turned_moved_and_scaled_cloud_keeps_the_same_points():
    rng = np.random.default_rng(3)
    points, tangents = rng.uniform(-1, 1, (800, 3)), rng.normal(size=(800, 3))
    turn = random_rotation(rng)
    kept = thin_points(points, tangents, 0.2, 0.8)
    assert 100 < len(kept) < 700
    moved = thin_points(5 * points @ turn.T + [3.0, -1.0, 2.0], -tangents @ turn.T, 1.0, 0.8)
    assert np.array_equal(kept, moved)


def test_thinning_twice_changes_nothing():
    points, tangents = cloud(np.random.default_rng(4), "lines", 500)
    kept = thin_points(points, tangents, 0.3, 0.5)
    assert np.array_equal(thin_points(points[kept], tangents[kept], 0.3, 0.5), np.arange(len(kept)))


def test_no_points_are_none():
    kept = thin_points(np.zeros((0, 3)), np.zeros((0, 3)), 1.0, 0.1)
    assert kept.shape == (0,)
    assert kept.dtype == np.int64


def test_nothing_is_changed_in_place():
    points, tangents = cloud(np.random.default_rng(5), "scattered", 50)
    before = points.copy(), tangents.copy()
    thin_points(points, tangents, 0.5, 0.5)
    np.testing.assert_array_equal(points, before[0])
    np.testing.assert_array_equal(tangents, before[1])


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("points", np.zeros((4, 2)), r"points must be \(N, 3\)"),
        ("tangents", np.ones((3, 3)), r"tangents must be \(4, 3\)"),
        ("radius", 0.0, "radius must be positive, got 0.0"),
        ("radius", math.inf, "radius must be positive, got inf"),
        ("radius", math.nan, "radius must be positive, got nan"),
        ("angle", -0.1, r"angle must be in \[0, pi/2\] rad, got -0.1"),
        ("angle", 30, r"angle must be in \[0, pi/2\] rad, got 30"),
        ("angle", math.nan, "angle must be in"),
    ],
)
def test_nonsense_is_rejected(name, value, text):
    arguments = {"points": np.zeros((4, 3)), "tangents": np.ones((4, 3)), "radius": 0.1, "angle": 0.5}
    with pytest.raises(ValueError, match=text):
        thin_points(**{**arguments, name: value})


def test_the_kernel_is_compiled_without_threads_and_fast_maths():
    assert not keep_first.targetoptions.get("fastmath")
    assert not keep_first.targetoptions.get("parallel")
