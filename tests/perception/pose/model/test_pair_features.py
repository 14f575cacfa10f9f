"""Pair features: cells worked by hand, signs, orbits, weights, visibility, degenerate input."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.geometry import matrix_from_quat, random_rotation, rotation_about
from perception.part import Symmetry
from perception.pose.model._pair_kernels import orbits, tangent_frames
from perception.pose.model.pair_features import WEIGHT_ONE, PairConfig, unit
from tests.perception.pose.pair_tables import table_of
from tests.reference import voting_twin

COARSE = PairConfig(distance_step=0.1, angle_step=math.radians(15), nearest=0.0, collinear=0.0)


def all_seen(points):
    return np.ones(len(points), dtype=np.uint32)


def cells_of(table):
    """Return {(f1, f2, f3, f4): set of (row, sign, angle)} of a table."""
    grid, out = table.grid, {}
    shape = (grid.distances, grid.inclinations, grid.inclinations, grid.half_turns)
    for c in np.flatnonzero(np.diff(table.offsets)):
        entries = table.entries[table.offsets[c] : table.offsets[c + 1]]
        key = tuple(int(f) for f in np.unravel_index(c, shape))
        out[key] = {(int(e) >> 9, (int(e) >> 8) & 1, int(e) & 255) for e in entries}
    return out


def random_edges(rng, count):
    points, tangents = rng.uniform(-0.5, 0.5, (count, 3)) / math.sqrt(3), rng.normal(size=(count, 3))
    return points, tangents


@pytest.mark.parametrize("seed", range(4))
def test_orbits_are_those_of_all_comparisons(seed):
    """Points on a coarse grid under three rotations, some of them alike in place alone or in direction alone."""
    rng = np.random.default_rng(seed)
    places = 0.01 * rng.integers(0, 3, (60, 3, 3)) + rng.uniform(0, 0.001, (60, 3, 3))
    directions = np.eye(3)[rng.integers(0, 3, (60, 3))] * rng.choice([-1.0, 1.0], (60, 3, 1))
    expected = []
    for m in range(60):
        first = [r for k, (r, _) in enumerate(expected) if r == k]
        far = np.linalg.norm(places[m] - places[first, 0][:, None], axis=-1).reshape(-1, 3)
        along = np.abs(np.sum(directions[m] * directions[first, 0][:, None], axis=-1)).reshape(-1, 3)
        fits = np.argwhere((far <= 0.005) & (along >= 0.9))
        r, s = (first[fits[0][0]], fits[0][1]) if len(fits) else (m, 0)
        expected.append((r, s))
    members, chosen, representatives = orbits(places, directions, 0.005, 0.9)
    assert list(zip(representatives[members], chosen, strict=True)) == expected
    assert list(representatives) == [m for m, (r, _) in enumerate(expected) if r == m]
    assert 3 < len(representatives) < 60
    assert chosen.any()


def test_one_pair_lies_in_the_cells_worked_by_hand():
    # d = (0.55, 0, 0); t_r is 40 deg from d, t_i 100 deg, so turned round 80 deg; the planes are at a right angle.
    r, i = math.radians(40), math.radians(100)
    points = np.array([[0.0, 0, 0], [0.55, 0, 0]])
    tangents = np.array([[math.cos(r), math.sin(r), 0], [math.cos(i), 0, math.sin(i)]])
    between = math.degrees(math.acos(-math.cos(r) * math.cos(i)))
    table = table_of(points, tangents, all_seen(points), 1.0, COARSE)
    cells = cells_of(table)
    f4 = int(between // 15)
    assert set(cells) == {(5, 2, 5, f4), (5, 5, 2, f4)}
    # t.d is positive for r, and for i too, whose d is (-0.55, 0, 0): no sign bit is set.
    ((row, sign, angle),) = cells[5, 2, 5, f4]
    assert (row, sign) == (0, 0)
    q = table.frames[0] @ (points[1] - points[0])
    turned = (math.atan2(q[2], q[1]) / (2 * math.pi) * 256) % 256
    assert (turned - angle) % 256 < 1
    assert {e[:2] for e in cells[5, 5, 2, f4]} == {(1, 0)}


def test_negated_tangents_keep_their_cells_and_change_the_sign_bit():
    points, tangents = random_edges(np.random.default_rng(0), 20)
    signs = np.where(np.arange(20) % 2, -1.0, 1.0)[:, None]
    one = cells_of(table_of(points, tangents, all_seen(points), 1.0, COARSE))
    other = cells_of(table_of(points, tangents * signs, all_seen(points), 1.0, COARSE))
    assert set(one) == set(other)
    for key, entries in one.items():
        assert {(m, sign ^ (m % 2)) for m, sign, _ in entries} == {(m, sign) for m, sign, _ in other[key]}


def test_without_the_flip_bit_signs_of_tangents_leave_cells_but_not_angles():
    points, tangents = random_edges(np.random.default_rng(8), 12)
    safe, no_flip = (
        cells_of(table_of(points, tangents, all_seen(points), 1.0, replace(COARSE, signs=signs)))
        for signs in ("safe", "no_flip")
    )
    assert set(safe) == set(no_flip)
    # The safe table keeps an angle negated where the sign is set: floor(-x) is 255 - floor(x) modulo 256.
    for key, entries in safe.items():
        assert {(m, 0, 255 - angle if sign else angle) for m, sign, angle in entries} == no_flip[key]
    assert any(sign for entries in safe.values() for _, sign, _ in entries)


def test_raw_signs_put_a_negated_tangent_into_the_supplementary_cells():
    # The pair worked by hand above, at 40 and 100 deg from d; negated, t_r is 140 deg from it.
    r, i = math.radians(40), math.radians(100)
    points = np.array([[0.0, 0, 0], [0.55, 0, 0]])
    tangents = np.array([[math.cos(r), math.sin(r), 0], [math.cos(i), 0, math.sin(i)]])
    between = math.degrees(math.acos(math.cos(r) * math.cos(i)))
    raw = replace(COARSE, signs="raw")
    # Seen from i, d points the other way: 80 and 140 deg.
    cells = cells_of(table_of(points, tangents, all_seen(points), 1.0, raw))
    assert set(cells) == {(5, 2, 6, int(between // 15)), (5, 5, 9, int(between // 15))}
    negated = cells_of(table_of(points, tangents * [[-1.0], [1.0]], all_seen(points), 1.0, raw))
    assert set(negated) == {(5, 9, 6, int((180 - between) // 15)), (5, 5, 2, int((180 - between) // 15))}
    assert {sign for entries in (*cells.values(), *negated.values()) for _, sign, _ in entries} == {0}


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    squared=st.booleans(),
    angle_step=st.sampled_from([7.0, 12.0, 18.0]),
    distance_step=st.sampled_from([0.05, 0.13]),
    signs=st.sampled_from(["safe", "no_flip", "raw"]),
)
def test_the_table_is_that_of_plain_loops(seed, squared, angle_step, distance_step, signs):
    rng = np.random.default_rng(seed)
    points, tangents = random_edges(rng, 16)
    if squared:  # many exact right angles, parallels and equal points
        points, tangents = rng.integers(-1, 2, (16, 3)) * 0.28, np.eye(3)[rng.integers(0, 3, 16)]
    visibility = rng.integers(0, 8, 16).astype(np.uint32)
    config = PairConfig(distance_step=distance_step, angle_step=math.radians(angle_step), signs=signs)
    table = table_of(points, tangents, visibility, 1.0, config)
    tangents = unit(tangents)
    expected = voting_twin.table(points, tangents, tangent_frames(tangents), visibility, config.grid(1.0), signs)
    assert cells_of(table) == expected


def test_points_never_seen_together_are_no_pair_unless_asked_for():
    points, tangents = random_edges(np.random.default_rng(1), 12)
    views = np.where(np.arange(12) < 6, 1, 2).astype(np.uint32)
    halves = table_of(points, tangents, views, 1.0, COARSE)
    whole = table_of(points, tangents, views, 1.0, PairConfig(**{**vars(COARSE), "same_view": False}))
    assert len(whole.entries) == 12 * 11
    assert len(halves.entries) == 2 * 6 * 5
    both = views | 4
    np.testing.assert_array_equal(table_of(points, tangents, both, 1.0, COARSE).entries, whole.entries)


def test_a_scaled_part_has_the_same_table():
    points, tangents = random_edges(np.random.default_rng(2), 30)
    one = table_of(points, tangents, all_seen(points), 1.0)
    large = table_of(4 * points, 0.5 * tangents, all_seen(points), 4.0)
    np.testing.assert_array_equal(one.offsets, large.offsets)
    np.testing.assert_array_equal(one.entries, large.entries)
    np.testing.assert_array_equal(4 * one.points, large.points)


@given(quat=st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1))
@settings(max_examples=30, deadline=None)
def test_frames_are_rotations_that_map_the_tangent_to_x(quat):
    tangents = np.concatenate([matrix_from_quat(quat), np.eye(3), -np.eye(3)])
    frames = tangent_frames(np.ascontiguousarray(tangents))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", frames, tangents), np.tile([1.0, 0, 0], (9, 1)), atol=1e-12)
    np.testing.assert_allclose(frames @ np.swapaxes(frames, 1, 2), np.tile(np.eye(3), (9, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0)


def circle(radius, height, count, phase=0.0):
    t = phase + 2 * np.pi * np.arange(count) / count
    around = np.stack([-np.sin(t), np.cos(t), np.zeros(count)], axis=1)
    return np.stack([radius * np.cos(t), radius * np.sin(t), np.full(count, height)], axis=1), around


def test_a_circle_about_the_axis_is_one_row_with_the_pairs_of_its_representative():
    points, tangents = circle(0.5, 0.1, 24)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], 24)[:, None]
    turn, offset = random_rotation(np.random.default_rng(3)), np.array([0.3, -0.2, 0.1])
    points, tangents = points @ turn.T + offset, (tangents * signs) @ turn.T
    spin = Symmetry(axis=turn @ [0.0, 0, 1])
    table = table_of(points, tangents, all_seen(points), 1.0, symmetry=spin, centre=offset)
    np.testing.assert_array_equal(table.rows, np.zeros(24))
    assert table.points.shape == (1, 3)
    # Up to rounding of angles to 1/256 turn, the 24 points have the same 23 pairs.
    assert len(table.entries) <= 3 * 23
    assert len(table_of(points, tangents, all_seen(points), 1.0).entries) > 12 * 20


def test_rows_are_told_apart_by_height_radius_and_tangent():
    rings = [circle(0.4, 0.0, 8), circle(0.4, 0.2, 8), circle(0.3, 0.0, 8, phase=0.1)]
    upright = (rings[0][0], np.tile([0.0, 0, 1], (8, 1)))
    points, tangents = (np.concatenate(x) for x in zip(*rings, upright, strict=True))
    table = table_of(points, tangents, all_seen(points), 1.0, symmetry=Symmetry(axis=np.array([0, 0, 1.0])))
    np.testing.assert_array_equal(table.rows, np.repeat(np.arange(4), 8))


def test_both_ends_of_a_turned_part_share_rows_where_it_can_be_swapped():
    points, tangents = (np.concatenate(x) for x in zip(circle(0.4, 0.2, 9), circle(0.4, -0.2, 9, 0.2), strict=True))
    swap = np.stack([np.eye(3), np.diag([1.0, -1, -1])])
    axis = np.array([0, 0, 1.0])
    table = table_of(
        points, tangents, all_seen(points), 1.0, symmetry=Symmetry(rotations=swap, axis=axis), centre=np.zeros(3)
    )
    assert set(table.rows) == {0}


def test_points_on_the_axis_are_grouped_by_their_tangent():
    axis = np.array([0, 0, 1.0])
    points = np.array([[0, 0, 0.0], [0.001, 0, 0.0], [0, 0, 0.0], [0.3, 0, 0]])
    tangents = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 0]])
    table = table_of(points, tangents, all_seen(points), 1.0, symmetry=Symmetry(axis=axis), centre=np.zeros(3))
    np.testing.assert_array_equal(table.rows, [0, 0, 1, 2])


def test_finite_symmetry_merges_the_points_it_swaps():
    half, _ = random_edges(np.random.default_rng(4), 10)
    tangents = np.random.default_rng(5).normal(size=(10, 3))
    turn = rotation_about([0, 0, 1], np.pi)
    points, tangents = np.concatenate([half, half @ turn.T]), np.concatenate([tangents, -tangents @ turn.T])
    pair = Symmetry(rotations=np.stack([np.eye(3), turn]))
    table = table_of(points, tangents, all_seen(points), 1.0, symmetry=pair, centre=np.zeros(3))
    np.testing.assert_array_equal(table.rows, np.tile(np.arange(10), 2))
    # Each of the 10 representatives keeps only its own pairs: its partner has the same, but for rounded angles.
    alone = table_of(points, tangents, all_seen(points), 1.0)
    assert len(table.entries) < 0.6 * len(alone.entries)


def test_weights_by_hand():
    # A row of parallel edges: the cell of neighbours has many entries, that of the far ends two.
    points = np.zeros((6, 3))
    points[:, 0] = np.arange(6) * 0.15
    tangents = np.tile([0.0, 1, 0], (6, 1))
    tables = {
        weighting: table_of(points, tangents, all_seen(points), 1.0, PairConfig(weighting=weighting, weight_cap=1.0))
        for weighting in ("none", "capped", "inverse")
    }
    counts = np.diff(tables["none"].offsets)
    filled = counts > 0
    np.testing.assert_array_equal(counts[filled], [10, 8, 6, 4, 2])
    np.testing.assert_array_equal(tables["none"].weights, WEIGHT_ONE)
    np.testing.assert_array_equal(tables["inverse"].weights[filled], np.rint(WEIGHT_ONE / counts[filled]))
    expected = [round(WEIGHT_ONE * w) for w in (6 / 10, 6 / 8, 1, 1, 1)]
    np.testing.assert_array_equal(tables["capped"].weights[filled], expected)


def test_points_without_a_direction_are_dropped_and_others_keep_their_rows():
    points, tangents = random_edges(np.random.default_rng(6), 8)
    tangents[2], tangents[5, 1], points[6, 0] = 0.0, np.nan, np.inf
    table = table_of(points, tangents, all_seen(points), 1.0)
    np.testing.assert_array_equal(table.rows, [0, 1, -1, 2, 3, -1, -1, 4])
    kept = [0, 1, 3, 4, 7]
    expected = table_of(points[kept], tangents[kept], all_seen(kept), 1.0)
    np.testing.assert_array_equal(table.entries, expected.entries)


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_points_make_an_empty_table(count):
    table = table_of(np.zeros((count, 3)), np.ones((count, 3)), all_seen(range(count)), 1.0)
    assert len(table.entries) == 0
    assert len(table.points) == count


def test_coincident_points_are_no_pair():
    table = table_of(np.zeros((3, 3)), np.eye(3), all_seen(range(3)), 1.0, COARSE)
    assert len(table.entries) == 0


def test_the_same_input_gives_the_same_table():
    points, tangents = random_edges(np.random.default_rng(7), 40)
    one, other = (table_of(points, tangents, all_seen(points), 1.0) for _ in range(2))
    np.testing.assert_array_equal(one.entries, other.entries)
    np.testing.assert_array_equal(one.offsets, other.offsets)


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("distance_step", 0.0, "distance_step must be in"),
        ("angle_step", 2.0, "angle_step must be in"),
        ("radius", math.nan, "radius must be in"),
        ("distance_noise", 0.03, "distance_noise must be in .* got 0.03"),
        ("angle_noise", -0.1, "angle_noise must be in"),
        ("nearest", 1.5, "nearest must be in"),
        ("collinear", 1.0, "collinear must be in"),
        ("orbit_angle", -1.0, "orbit_angle must be in"),
        ("orbit_distance", 0.0, "orbit_distance must be positive"),
        ("weight_cap", math.inf, "weight_cap must be positive"),
        ("weighting", "log", "weighting must be .* got 'log'"),
        ("signs", "flip", "signs must be 'safe', 'no_flip' or 'raw', got 'flip'"),
        ("angle_step", 0.01, "cells, at most"),
    ],
)
def test_config_rejects_nonsense(field, value, text):
    overrides = {"angle_noise": 0.0} if field == "angle_step" else {}
    with pytest.raises(ValueError, match=text):
        PairConfig(**{**overrides, field: value})


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("points", np.zeros((4, 2)), r"points must be \(N, 3\)"),
        ("tangents", np.ones((3, 3)), r"tangents must be \(4, 3\)"),
        ("visibility", np.ones(3, np.uint32), r"visibility must be \(4,\)"),
        ("d_max", 0.0, "d_max must be positive, got 0.0"),
        ("centre", np.zeros(2), r"centre must be \(3,\)"),
    ],
)
def test_build_table_rejects_nonsense(name, value, text):
    arguments = {"points": np.zeros((4, 3)), "tangents": np.ones((4, 3)), "visibility": all_seen(range(4))}
    arguments["d_max"] = 1.0
    with pytest.raises(ValueError, match=text):
        table_of(**{**arguments, name: value})
