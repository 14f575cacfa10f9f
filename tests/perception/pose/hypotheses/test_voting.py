"""Voting: against its naive twin, on wireframes whose poses are known, under signs, noise, clutter and symmetry."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.geometry import invert_transform, make_transform, random_rotation, rotation_about, transform_points
from perception.part import Symmetry, diameter
from perception.pose.hypotheses._kernels import accumulate, vote_references
from perception.pose.hypotheses.voting import RawPoses, VoteConfig, reference_points, vote
from perception.pose.model._pair_kernels import tangent_frames
from perception.pose.model.pair_features import WEIGHT_ONE, PairConfig, unit
from tests.perception.pose.bracket_scene import (
    BRACKET,
    EVERY,
    STEP,
    D,
    bracket_scene,
    bracket_table,
    is_right,
    prism,
    sample,
    share_right,
)
from tests.perception.pose.pair_tables import table_of
from tests.reference import voting_twin


def votes_of(table, points, tangents, reference, bins):
    """Return {(row, flip, bin): votes} as the kernel casts them."""
    votes = np.zeros((2 * len(table.points), bins), np.int32)
    frame = tangent_frames(tangents)[reference]
    cells = (table.offsets, table.entries, table.weights, table.grid)
    accumulate(votes, points, tangents, frame, reference, *cells)
    assert np.all(votes % WEIGHT_ONE == 0)
    return {(int(k) // 2, int(k) % 2, int(b)): int(votes[k, b]) // WEIGHT_ONE for k, b in np.argwhere(votes)}


def small_case(seed, squared):
    """Return model and scene of 14 and 12 edge points; ``squared`` ones have many right angles and equal points."""
    rng = np.random.default_rng(seed)
    if not squared:
        points, tangents = rng.uniform(-0.29, 0.29, (2, 14, 3)), rng.normal(size=(2, 14, 3))
    else:
        points, tangents = rng.integers(-1, 2, (2, 14, 3)) * 0.28, np.eye(3)[rng.integers(0, 3, (2, 14))]
    return points[0], unit(tangents[0]), points[1, :12].copy(), unit(tangents[1, :12])


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    squared=st.booleans(),
    noise=st.sampled_from([0.0, 0.3, 0.5]),
    bins=st.sampled_from([5, 30]),
    signs=st.sampled_from(["safe", "no_flip", "raw"]),
)
def test_votes_are_those_of_plain_loops(seed, squared, noise, bins, signs):
    model, model_tangents, points, tangents = small_case(seed, squared)
    config = PairConfig(
        distance_step=0.1, distance_noise=noise * 0.1, angle_noise=noise * math.radians(12), signs=signs
    )
    visibility = np.arange(1, 15).astype(np.uint32)
    table = table_of(model, model_tangents, visibility, 1.0, config)
    grid = config.grid(1.0)
    frames = tangent_frames(unit(model_tangents))
    entries = voting_twin.table(model, unit(model_tangents), frames, visibility, grid, signs)
    frames = tangent_frames(tangents)
    for r in range(0, 12, 4):
        expected = voting_twin.votes(entries, points, tangents, frames[r], r, grid, bins, signs)
        assert votes_of(table, points, tangents, r, bins) == expected


@pytest.mark.parametrize("seed", range(3))
def test_the_best_pose_is_that_of_the_twins_highest_smoothed_votes(seed):
    model, model_tangents, _, _ = small_case(seed, False)
    points, tangents = transform_points(make_transform(rotation_about([1, 2, 3], 0.7)), model), model_tangents[::-1]
    table = table_of(model, model_tangents, np.ones(14, np.uint32), 1.0)
    grid = table.grid
    entries = voting_twin.table(model, model_tangents, tangent_frames(model_tangents), np.ones(14), grid)
    tangents = unit(tangents)
    frame = tangent_frames(tangents)[3]
    votes = np.zeros((14, 2, 30), int)
    for key, count in voting_twin.votes(entries, points, tangents, frame, 3, grid, 30).items():
        votes[key] = count
    smoothed = np.array([voting_twin.smoothed(row) for row in votes.reshape(28, 30)]).reshape(votes.shape)
    row, flip, b = np.unravel_index(np.argmax(smoothed), smoothed.shape)  # the first of equals
    raw = vote(table, points, tangents, np.array([3]))
    assert raw.votes[0] == smoothed.max() / 4
    # Model point on scene point, tangent on tangent (against it if flipped), and the turn within reach of the bin.
    T = raw.T_cam_part[0]
    np.testing.assert_allclose(transform_points(T, model[row : row + 1])[0], points[3], atol=1e-12)
    np.testing.assert_allclose(T[:3, :3] @ model_tangents[row], (-1 if flip else 1) * tangents[3], atol=1e-12)
    side = np.diag([-1.0, 1, -1]) if flip else np.eye(3)
    turned = frame @ T[:3, :3] @ (side @ tangent_frames(model_tangents)[row]).T
    offset = math.atan2(turned[2, 1], turned[1, 1]) / (2 * math.pi) * 30 - (b + 0.5)
    assert abs((offset + 15) % 30 - 15) <= 1


@pytest.mark.parametrize("seed", range(2))
def test_a_noiseless_wireframe_is_found_at_nearly_every_reference(seed):
    points, tangents, T_cam_part, _ = bracket_scene(np.random.default_rng(seed))
    references = np.arange(0, len(points), 3)
    raw = vote(bracket_table(), points, tangents, references, EVERY)
    assert share_right(raw, T_cam_part, references) >= 0.95
    assert is_right(raw, T_cam_part)[:10].all()
    assert set(references) == set(raw.reference)


def test_missing_edges_clutter_and_noise_leave_most_references_right():
    rng = np.random.default_rng(5)
    table = bracket_table()
    for _ in range(3):
        scene = bracket_scene(rng, missing=0.4, clutter=200, offset=0.003 * D, tilt=math.radians(4))
        points, tangents, T_cam_part, on_part = scene
        references = np.flatnonzero(on_part)[::4]
        raw = vote(table, points, tangents, references, EVERY)
        assert share_right(raw, T_cam_part, references) >= 0.9
        # References on clutter find poses with fewer votes: none is among the best.
        everywhere = vote(table, points, tangents, None, VoteConfig(keep=5))
        assert is_right(everywhere, T_cam_part, distance=0.1, angle=15).all()


def test_a_moved_scene_gives_moved_poses():
    rng = np.random.default_rng(8)
    points, tangents, _, _ = bracket_scene(rng)
    T_new_cam = make_transform(random_rotation(rng), [0.4, -0.1, 0.3])
    table, references = bracket_table(), np.arange(0, len(points), 12)
    config = VoteConfig(keep=len(references), second_peak=1.0)
    raw = vote(table, points, tangents, references, config)
    moved = vote(table, transform_points(T_new_cam, points), tangents @ T_new_cam[:3, :3].T, references, config)
    back = {int(r): invert_transform(T_new_cam) @ T for r, T in zip(moved.reference, moved.T_cam_part, strict=True)}
    agree = [
        is_right(RawPoses(T_cam_part=back[int(r)][None], votes=np.ones(1), reference=np.zeros(1)), T)[0]
        for r, T in zip(raw.reference, raw.T_cam_part, strict=True)
    ]
    assert np.mean(agree) >= 0.95


def test_a_scaled_scene_gives_scaled_poses():
    points, tangents, _, _ = bracket_scene(np.random.default_rng(9))
    model, model_tangents = sample(BRACKET, STEP * D)
    seen = np.ones(len(model), np.uint32)
    raw = vote(table_of(model, model_tangents, seen, D), points, tangents)
    large = vote(table_of(8 * model, model_tangents, seen, 8 * D), 8 * points, tangents)
    np.testing.assert_array_equal(raw.votes, large.votes)
    np.testing.assert_array_equal(raw.reference, large.reference)
    np.testing.assert_array_equal(raw.T_cam_part[:, :3, :3], large.T_cam_part[:, :3, :3])
    np.testing.assert_array_equal(8 * raw.T_cam_part[:, :3, 3], large.T_cam_part[:, :3, 3])


def test_spreading_recovers_votes_that_noise_takes_across_borders():
    narrow = bracket_table(PairConfig(angle_noise=0.0))
    wide = bracket_table(PairConfig(angle_noise=math.radians(5), distance_noise=0.015))
    rng, gain = np.random.default_rng(10), []
    for _ in range(3):
        points, tangents, T_cam_part, _ = bracket_scene(rng, offset=0.003 * D, tilt=math.radians(5))
        references = np.arange(0, len(points), 20)
        best = []
        for table in (narrow, wide):
            raw = vote(table, points, tangents, references, EVERY)
            right = is_right(raw, T_cam_part, angle=15)
            assert right.any()
            best.append(raw.votes[right].mean())
        gain.append(best[1] / best[0])
    assert min(gain) > 1.3


def rings_scene(rng):
    """Return model, scene and truth of three coaxial circles that tell the ends apart."""
    rings = []
    for radius, height in ((0.04, 0.0), (0.025, 0.03), (0.025, 0.045)):
        count = round(2 * np.pi * radius / 0.003)
        t = 2 * np.pi * (np.arange(count) + rng.random()) / count
        points = np.stack([radius * np.cos(t), radius * np.sin(t), np.full(len(t), height)], axis=1)
        rings.append((points, np.stack([-np.sin(t), np.cos(t), np.zeros(len(t))], axis=1)))
    model, tangents = (np.concatenate(x) for x in zip(*rings, strict=True))
    T_cam_part = make_transform(random_rotation(rng), [0.1, 0.0, 0.8])
    signs = rng.choice([-1.0, 1.0], len(model))[:, None]
    return model, tangents, transform_points(T_cam_part, model), signs * tangents @ T_cam_part[:3, :3].T, T_cam_part


def test_a_solid_of_revolution_gathers_the_votes_of_its_circles():
    model, model_tangents, points, tangents, T_cam_part = rings_scene(np.random.default_rng(11))
    spin, centre = Symmetry(axis=np.array([0.0, 0, 1])), np.array([0, 0, 0.02])
    seen, size = np.ones(len(model), np.uint32), diameter(model)
    merged = table_of(model, model_tangents, seen, size, symmetry=spin, centre=centre)
    split = table_of(model, model_tangents, seen, size)
    assert len(merged.points) == 3
    assert len(merged.entries) < 0.2 * len(split.entries)
    raw = vote(merged, points, tangents, np.arange(len(points)), EVERY)
    right = is_right(raw, T_cam_part, spin, centre)
    assert len(np.unique(raw.reference[right])) >= 0.95 * len(points)


def test_a_declared_half_turn_halves_the_rows_and_finds_the_pose():
    turn = rotation_about([0, 0, 1], np.pi)
    half = prism(((0.01, 0), (0.05, 0), (0.05, 0.01), (0.03, 0.02)), 0.015)
    edges = np.concatenate([half, half @ turn.T])
    model, model_tangents = sample(edges, 0.0025)
    pair = Symmetry(rotations=np.stack([np.eye(3), turn]))
    size = diameter(edges.reshape(-1, 3))
    table = table_of(model, model_tangents, np.ones(len(model), np.uint32), size, symmetry=pair, centre=np.zeros(3))
    assert len(table.points) == len(model) // 2
    T_cam_part = make_transform(random_rotation(np.random.default_rng(12)), [0, 0.1, 0.7])
    points, tangents = transform_points(T_cam_part, model), model_tangents @ T_cam_part[:3, :3].T
    references = np.arange(0, len(points), 7)
    raw = vote(table, points, tangents, references, EVERY)
    right = is_right(raw, T_cam_part, pair, np.zeros(3))
    assert len(np.unique(raw.reference[right])) >= 0.95 * len(references)


def test_equally_good_second_poses_are_kept_and_lesser_ones_are_not():
    # A square frame, its symmetry not declared: four turns and, seen from below, four more fit each reference point.
    square = np.array([(x, y, 0.0) for x, y in ((0, 0), (0.1, 0), (0.1, 0.1), (0, 0.1))])
    edges = np.stack([square, np.roll(square, -1, axis=0)], axis=1)
    model, tangents = sample(edges, 0.004)
    table = table_of(model, tangents, np.ones(len(model), np.uint32), 0.1 * math.sqrt(2))
    references = np.arange(0, len(model), 9)
    raw = vote(table, model, tangents, references, EVERY)
    found, counts = np.unique(raw.reference, return_counts=True)
    assert set(found) == set(references)
    assert np.mean(counts == 2) > 0.9
    pairs = [raw.T_cam_part[raw.reference == r] for r in found[counts == 2]]
    moved = [np.linalg.norm((a - b)[:3, :3] @ table.centre + (a - b)[:3, 3]) for a, b in pairs]
    traces = np.array([np.trace(a[:3, :3].T @ b[:3, :3]) for a, b in pairs])
    differ = (np.array(moved) > 0.1 * table.d_max) | ((traces - 1) / 2 < math.cos(EVERY.second_angle))
    assert differ.all()
    points, tangents, _, _ = bracket_scene(np.random.default_rng(13))
    alone = vote(bracket_table(), points, tangents, None, replace(EVERY, second_peak=1.0))
    assert np.mean(np.unique(alone.reference, return_counts=True)[1]) < 1.1


def test_views_that_exclude_each_other_leave_no_votes():
    model, tangents = sample(BRACKET, 3 * STEP * D)
    apart = (np.uint32(1) << np.arange(len(model), dtype=np.uint32) % np.uint32(32)).astype(np.uint32)[:32]
    model, tangents = model[:32], tangents[:32]
    assert len(vote(table_of(model, tangents, apart, D), model, tangents)) == 0
    assert len(vote(table_of(model, tangents, apart, D, PairConfig(same_view=False)), model, tangents)) > 0


def test_poses_are_sorted_and_cut_and_repeat_bit_by_bit():
    points, tangents, _, _ = bracket_scene(np.random.default_rng(14), clutter=50)
    table = bracket_table()
    raw = vote(table, points, tangents, None, EVERY)
    assert np.all(np.lexsort((raw.reference, -raw.votes)) == np.arange(len(raw)))
    again = vote(table, points, tangents, None, EVERY)
    np.testing.assert_array_equal(raw.T_cam_part, again.T_cam_part)
    few = vote(table, points, tangents, None, replace(EVERY, keep=7))
    np.testing.assert_array_equal(few.T_cam_part, raw.T_cam_part[:7])
    np.testing.assert_array_equal(few.votes, raw.votes[:7])
    np.testing.assert_allclose(np.linalg.det(raw.T_cam_part[:, :3, :3]), 1.0)


def test_points_without_a_direction_neither_vote_nor_shift_the_references():
    points, tangents, T_cam_part, _ = bracket_scene(np.random.default_rng(15))
    lost = np.arange(0, len(points), 5)
    blank, holed = tangents.copy(), points.copy()
    blank[lost[::2]] = 0.0
    holed[lost[1::2]] = np.nan
    kept = np.setdiff1d(np.arange(len(points)), lost)
    table = bracket_table()
    raw = vote(table, holed, blank, np.array([0, kept[3], kept[8]]), EVERY)
    expected = vote(table, points[kept], tangents[kept], np.array([3, 8]), EVERY)
    np.testing.assert_array_equal(raw.reference, kept[expected.reference])
    np.testing.assert_array_equal(raw.T_cam_part, expected.T_cam_part)
    assert is_right(raw, T_cam_part).any()


@pytest.mark.parametrize(
    ("count", "step"), [(0, 1), (30, 1), (49, 1), (50, 2), (100, 4), (199, 7), (200, 8), (1000, 8)]
)
def test_references_are_every_eighth_or_closer(count, step):
    np.testing.assert_array_equal(reference_points(count), np.arange(0, count, step))


@pytest.mark.parametrize(("count", "step"), [(0, 1), (30, 1), (79, 1), (80, 2), (160, 4), (1000, 5)])
def test_references_are_as_close_as_is_asked_for(count, step):
    config = VoteConfig(reference_step=5, min_references=40)
    np.testing.assert_array_equal(reference_points(count, config), np.arange(0, count, step))


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_points_than_a_pair_give_no_pose(count):
    raw = vote(bracket_table(), np.zeros((count, 3)), np.ones((count, 3)))
    assert len(raw) == 0
    assert raw.T_cam_part.shape == (0, 4, 4)


def test_coincident_points_empty_tables_and_far_points_give_no_pose():
    points, tangents = np.zeros((5, 3)), np.eye(3)[[0, 1, 2, 0, 1]]
    assert len(vote(bracket_table(), points, tangents)) == 0
    far = np.arange(5)[:, None] * [10.0, 0, 0]
    assert len(vote(bracket_table(), far, tangents)) == 0
    empty = table_of(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.uint32), D)
    assert len(vote(empty, *sample(BRACKET, 0.01))) == 0
    assert len(vote(bracket_table(), *sample(BRACKET, 0.01), references=np.zeros(0, np.int64))) == 0


def test_every_setting_reaches_the_kernel():
    points, tangents, _, _ = bracket_scene(np.random.default_rng(16), clutter=100, tilt=0.05)
    table, base = bracket_table(), vote(bracket_table(), points, tangents)
    for change in (
        {"bins": 12},
        {"reference_step": 2},
        {"min_references": 200},
        {"keep": 3},
        {"second_peak": 0.3},
    ):
        assert not np.array_equal(vote(table, points, tangents, None, VoteConfig(**change)).votes, base.votes), change
    # A second pose counts as another one sooner or later.
    loose = VoteConfig(second_peak=0.2, keep=10_000)
    for change in ({"second_distance": 1.0, "second_angle": 3.1}, {"second_angle": 3.1}):
        others = vote(table, points, tangents, None, replace(loose, **change))
        assert not np.array_equal(others.T_cam_part, vote(table, points, tangents, None, loose).T_cam_part)


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("bins", 2, r"bins must be in \[3, 256\], got 2"),
        ("reference_step", 0, "reference_step must be at least 1, got 0"),
        ("min_references", 0, "min_references must be at least 1"),
        ("keep", 0, "keep must be at least 1"),
        ("second_peak", 1.5, "second_peak must be in"),
        ("second_distance", 0.0, "second_distance must be in"),
        ("second_angle", math.nan, "second_angle must be in"),
    ],
)
def test_config_rejects_nonsense(field, value, text):
    with pytest.raises(ValueError, match=text):
        VoteConfig(**{field: value})


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("points_cam", np.zeros((4, 2)), r"points_cam must be \(N, 3\)"),
        ("tangents_cam", np.ones((3, 3)), r"tangents_cam must be \(4, 3\)"),
        ("references", np.zeros((1, 1), np.int64), r"references must be \(N,\)"),
        ("references", np.zeros(1), "references must be integers, got float64"),
        ("references", np.array([4]), r"references must be in \[0, 4\), got 4 to 4"),
        ("references", np.array([-1]), r"references must be in \[0, 4\)"),
    ],
)
def test_vote_rejects_nonsense(name, value, text):
    arguments = {"points_cam": np.zeros((4, 3)), "tangents_cam": np.ones((4, 3)), "references": None}
    with pytest.raises(ValueError, match=text):
        vote(bracket_table(), **{**arguments, name: value})


def test_raw_poses_have_one_vote_and_reference_each():
    with pytest.raises(ValueError, match=r"votes must be \(2,\)"):
        RawPoses(T_cam_part=np.zeros((2, 4, 4)), votes=np.zeros(1), reference=np.zeros(2, np.int64))


def test_the_kernel_is_compiled_without_threads_and_fast_maths():
    assert not vote_references.targetoptions.get("fastmath")
    assert not vote_references.targetoptions.get("parallel")
