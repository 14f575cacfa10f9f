"""Bregier's distance between poses, and the average precision that is counted with it."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.geometry import make_transform, rotation_about, transform_points
from perception.metrics.average_precision import PrecisionRecall
from perception.metrics.pose_distance import PoseSpace, surface_moments
from perception.metrics.pose_errors import recognition_distances
from perception.metrics.pose_recognition import (
    MAX_DISTANCE,
    PoseVerdicts,
    judge_poses,
    pose_average_precision,
    pose_precision_recall,
    visible_enough,
)
from perception.part import PartModel, Symmetry
from tests.perception.pose import posed_parts as at
from tests.perception.pose.posed_parts import PARTS, X, Z

TWIN = Path(__file__).resolve().parents[2] / "reference" / "pose_error_twin.py"
twin = SimpleNamespace(**runpy.run_path(str(TWIN)))
AHEAD = make_transform(None, (0.0, 0.0, 1.0))
CUBE_SPREAD = np.sqrt(5.0) / 3  # of a cube of half side 1: two faces at 1 and four of mean square 1/3

parts = st.sampled_from(PARTS)
seeds = st.integers(0, 2**32 - 1)
sizes = st.sampled_from([0.0, 1e-9, 1e-4, 0.05, 1.0])
few = settings(deadline=None, max_examples=25)


# The surface's moments


def test_moments_of_a_cube_by_hand() -> None:
    centroid, covariance = surface_moments(at.cube().mesh)
    np.testing.assert_allclose(centroid, np.zeros(3), atol=1e-17)
    np.testing.assert_allclose(covariance, 1e-4 * CUBE_SPREAD**2 * np.eye(3), rtol=1e-12, atol=1e-18)


def test_moments_are_of_the_surface_and_not_of_the_vertices() -> None:
    whole = at.wedge().mesh
    cut = trimesh.Trimesh(*trimesh.remesh.subdivide(whole.vertices, whole.faces, face_index=[0]), process=False)
    assert len(cut.vertices) > len(whole.vertices)
    for expected, measured in zip(surface_moments(whole), surface_moments(cut), strict=True):
        np.testing.assert_allclose(measured, expected, rtol=1e-12, atol=1e-15)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    ball.apply_translation((10.0, 20.0, 30.0))
    centroid, covariance = surface_moments(ball)
    np.testing.assert_allclose(centroid, (10.0, 20.0, 30.0), rtol=1e-14)
    np.testing.assert_allclose(covariance, 0.03**2 / 3 * np.eye(3), rtol=0.02, atol=1e-12)


def test_a_mesh_without_a_surface_is_refused() -> None:
    flat = trimesh.Trimesh(vertices=[(0, 0, 0), (1, 0, 0), (2, 0, 0)], faces=[(0, 1, 2)], process=False)
    with pytest.raises(ValueError, match=r"must have a surface, got 1 triangles of area 0"):
        surface_moments(flat)


# The distance


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_a_shift_costs_its_length(part: PartModel) -> None:
    shift = make_transform(None, (0.003, -0.004, 1.0))
    assert PoseSpace.of(part).distance(shift, AHEAD) == pytest.approx(0.005)


@pytest.mark.parametrize("degrees", [1e-5, 5.0, 90.0, 180.0])
def test_a_turn_of_a_cube_by_hand(degrees: float) -> None:
    angle, spread = np.deg2rad(degrees), 0.01 * CUBE_SPREAD
    turn = AHEAD @ make_transform(rotation_about(Z, angle))
    expected = 2 * np.sqrt(2) * spread * np.sin(angle / 2)  # two axes of the cube turn, the third stays
    assert PoseSpace.of(at.cube()).distance(turn, AHEAD) == pytest.approx(expected)


def test_the_half_turn_of_a_lid_costs_nothing_and_others_do() -> None:
    part = at.lid()
    space = PoseSpace.of(part)
    assert space.distance(AHEAD @ at.about_centre(part, at.HALF_TURN), AHEAD) == pytest.approx(0.0, abs=1e-15)
    assert space.distance(AHEAD @ at.about_centre(part, rotation_about(Z, np.pi / 2)), AHEAD) > 0.02
    assert space.distance(AHEAD @ at.about_centre(part, at.FLIP), AHEAD) > 0.02


@pytest.mark.parametrize("part", [at.wheel(), at.rod()], ids=["wheel", "rod"])
def test_spin_costs_nothing_a_tilt_its_sine_and_flipped_ends_if_they_differ(part: PartModel) -> None:
    space = PoseSpace.of(part)
    spin = rotation_about(Z, 1.234)
    assert space.distance(AHEAD @ at.about_centre(part, spin), AHEAD) == pytest.approx(0.0, abs=1e-15)
    _, covariance = surface_moments(part.mesh)
    reach = np.sqrt(covariance[0, 0] + covariance[2, 2])
    about = make_transform(None, space.centroid)
    tilt = about @ make_transform(rotation_about(X, 0.3) @ spin) @ np.linalg.inv(about)
    assert space.distance(AHEAD @ tilt, AHEAD) == pytest.approx(2 * reach * np.sin(0.15))
    flip = about @ make_transform(at.FLIP) @ np.linalg.inv(about)
    expected = 0.0 if len(part.symmetry.rotations) == 2 else 2 * reach
    assert space.distance(AHEAD @ flip, AHEAD) == pytest.approx(expected, abs=1e-15)


def test_representatives_have_the_sizes_of_the_paper() -> None:
    pose = np.broadcast_to(AHEAD, (5, 4, 4))
    shapes = [PoseSpace.of(part).representatives(pose).shape for part in PARTS]
    assert shapes == [(5, 1, 12), (5, 2, 12), (5, 1, 6), (5, 2, 6)]
    repeated = Symmetry(rotations=np.stack([np.eye(3), at.HALF_TURN]), axis=Z)  # a half spin is no new end
    part = at.wheel()
    space = PoseSpace.of(PartModel.from_mesh("wheel", part.mesh, repeated))
    np.testing.assert_allclose(space.bases, PoseSpace.of(part).bases, atol=1e-15)


@settings(deadline=None, max_examples=8)
@given(parts, seeds, sizes)
def test_the_distance_is_the_surfaces_mean_square_motion(part: PartModel, seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    a = at.random_pose(rng)
    b = at.random_nearby(a, part, rng, size) @ at.random_element(part, rng)
    steps = 48
    sampled = twin.surface_distance(a, b, part.mesh.triangles.tolist(), part.symmetry.elements(steps), part.centre)
    distance = PoseSpace.of(part).distance(a, b)
    step = 0.0 if part.symmetry.axis is None else 0.04 * np.pi / steps  # 0.04 m: the widest part's radius
    assert distance <= sampled + 1e-9
    assert distance >= sampled - step - 1e-9


@few
@given(parts, seeds, sizes)
def test_the_distance_is_a_metric_that_sees_no_symmetry(part: PartModel, seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    a = at.random_pose(rng)
    b, c, world = at.random_nearby(a, part, rng, size), at.random_nearby(a, part, rng, size), at.random_pose(rng)
    space = PoseSpace.of(part)
    distance = space.distance(a, b)
    assert space.distance(a, a) == 0.0
    assert space.distance(b, a) == pytest.approx(distance, abs=1e-12)
    assert space.distance(world @ a, world @ b) == pytest.approx(distance, abs=1e-12)
    unseen = space.distance(a @ at.random_element(part, rng), b @ at.random_element(part, rng))
    assert unseen == pytest.approx(distance, abs=1e-12)
    assert space.distance(a, c) <= distance + space.distance(b, c) + 1e-12
    assert space.distances(np.stack([a, b]), np.stack([a, b, c])).shape == (2, 3)
    assert space.distances(np.stack([a, b]), np.stack([a, b, c]))[0, 2] == space.distance(a, c)


def test_the_distance_does_not_depend_on_where_the_drawing_has_its_origin() -> None:
    rng = np.random.default_rng(3)
    T_new_old = at.random_pose(rng)
    for part in PARTS:
        turn = T_new_old[:3, :3]
        group = Symmetry(
            rotations=turn @ part.symmetry.rotations @ turn.T,
            axis=None if part.symmetry.axis is None else turn @ part.symmetry.axis,
        )
        moved = PartModel.from_mesh(part.name, part.mesh.copy().apply_transform(T_new_old), group)
        a, b = at.random_pose(rng), at.random_pose(rng)
        old_new = np.linalg.inv(T_new_old)
        expected = PoseSpace.of(part).distance(a, b)
        assert PoseSpace.of(moved).distance(a @ old_new, b @ old_new) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("symmetry", [at.lid().symmetry, at.wheel().symmetry], ids=["turns", "axis"])
def test_a_mesh_that_lacks_a_declared_symmetry_is_given_it(symmetry: Symmetry) -> None:
    part = PartModel.from_mesh("block", at.wedge().mesh, symmetry)
    space = PoseSpace.of(part)
    np.testing.assert_allclose(space.centroid[:2], part.centre[:2], atol=1e-15)
    assert space.centroid[2] == pytest.approx(surface_moments(part.mesh)[0][2])
    half = at.about_centre(part, at.HALF_TURN)
    assert space.distance(AHEAD @ half, AHEAD) == pytest.approx(0.0, abs=1e-15)
    tilted = AHEAD @ at.about_centre(part, rotation_about((0.5, 0.3, 0.4), 0.4)) @ half
    there, back = space.distance(tilted, AHEAD), space.distance(AHEAD, tilted)
    assert there == pytest.approx(back, rel=1e-12)
    assert space.distance(tilted @ half, AHEAD) == pytest.approx(there, rel=1e-12)


def test_a_wrong_space_or_pose_is_refused() -> None:
    with pytest.raises(ValueError, match=r"centroid must be \(3,\), got \(2,\)"):
        PoseSpace(centroid=np.zeros(2), bases=np.zeros((1, 3, 3)))
    with pytest.raises(ValueError, match=r"bases must be \(N, 3, N\), got \(3, 3\)"):
        PoseSpace(centroid=np.zeros(3), bases=np.zeros((3, 3)))
    with pytest.raises(ValueError, match=r"at least one representative, got none"):
        PoseSpace(centroid=np.zeros(3), bases=np.zeros((0, 3, 3)))
    space = PoseSpace.of(at.wedge())
    with pytest.raises(ValueError, match=r"poses must be \(..., 4, 4\), got \(3, 4\)"):
        space.representatives(AHEAD[:3])
    with pytest.raises(ValueError, match=r"T_a must be \(N, 4, 4\), got \(4, 4\)"):
        space.distances(AHEAD, AHEAD[None])
    with pytest.raises(ValueError, match=r"T_b must be \(N, 4, 4\), got \(4, 4\)"):
        space.distances(AHEAD[None], AHEAD)


# Verdicts

FAR = 9.0
HAND_SCORES = np.array([0.5, 0.9, 0.8, 0.7, 0.6, 0.4])
# Two instances to find and one that is hidden. Of the first: the second and third estimate; of the hidden one: the next
# two; of the second instance: the first; of none: the last.
HAND_DISTANCES = np.array(
    [(FAR, 0.05, FAR), (0.06, FAR, FAR), (0.01, FAR, 0.2), (FAR, FAR, 0.0), (FAR, 0.3, 0.09), (0.2, 0.1, 0.4)]
)
HAND_TO_FIND = np.array([True, True, False])


def hand_verdicts() -> PoseVerdicts:
    return judge_poses(HAND_DISTANCES, HAND_SCORES, HAND_TO_FIND, 0.1)


def test_verdicts_by_hand() -> None:
    verdicts = hand_verdicts()
    assert verdicts.claims.tolist() == [1, 0, 0, 2, 2, -1]
    assert verdicts.correct.tolist() == [True, True, False, False, False, False]
    assert verdicts.excused.tolist() == [False, False, False, True, False, False]
    assert verdicts.to_find == 2


def test_precision_and_recall_by_hand() -> None:
    curve = pose_precision_recall([hand_verdicts()])
    assert curve.scores.tolist() == [0.4, 0.5, 0.6, 0.7, 0.8, 0.9, np.inf]
    assert curve.precision == pytest.approx([2 / 5, 2 / 4, 1 / 3, 1 / 2, 1 / 2, 1, 1])
    assert curve.recall == pytest.approx([1, 1, 0.5, 0.5, 0.5, 0.5, 0])
    assert pose_average_precision(curve) == pytest.approx(0.5 * 1.0 + 0.5 * 0.5)


def test_of_equal_scores_the_first_is_right_and_both_are_one_point() -> None:
    verdicts = judge_poses(np.array([[0.05], [0.01]]), np.array([0.5, 0.5]), np.array([True]), 0.1)
    assert verdicts.correct.tolist() == [True, False]
    curve = pose_precision_recall([verdicts])
    assert curve.precision.tolist() == [0.5, 1.0]
    assert pose_average_precision(curve) == 0.5


def test_an_estimate_just_at_the_distance_is_of_no_instance() -> None:
    verdicts = judge_poses(np.array([[0.1], [np.nextafter(0.1, 0)]]), np.array([0.9, 0.5]), np.array([True]), 0.1)
    assert verdicts.claims.tolist() == [-1, 0]
    assert verdicts.correct.tolist() == [False, True]


def test_an_instance_is_not_lost_to_a_nearer_estimate_of_its_neighbour() -> None:
    # Flat parts in a stack, 5 mm apart: the second estimate is the nearest of both, and its own is the first.
    distances = np.array([[0.0090, 0.0040], [0.0024, 0.0026]])
    verdicts = judge_poses(distances, np.array([0.5, 0.4]), np.array([True, True]), 0.008)
    assert verdicts.claims.tolist() == [1, 0]
    assert verdicts.correct.all()


def test_counting_over_scenes_by_hand() -> None:
    empty = judge_poses(np.empty((1, 0)), np.array([0.65]), np.empty(0, bool), 0.1)
    assert empty.claims.tolist() == [-1]
    curve = pose_precision_recall([hand_verdicts(), empty])
    assert curve.scores.tolist() == [0.4, 0.5, 0.6, 0.65, 0.7, 0.8, 0.9, np.inf]
    assert curve.precision == pytest.approx([0.2, 0.25, 1 / 6, 0.25, 0.75, 0.75, 1, 1])
    assert curve.recall == pytest.approx([1, 1, 0.5, 0.5, 0.5, 0.5, 0.5, 0])
    pooled = pose_precision_recall([hand_verdicts(), empty], pooled=True)
    assert pooled.precision == pytest.approx([2 / 6, 2 / 5, 1 / 4, 1 / 3, 1 / 2, 1 / 2, 1, 1])
    assert pooled.recall == pytest.approx(curve.recall)
    twice = pose_precision_recall([hand_verdicts()] * 2, pooled=True)
    np.testing.assert_array_equal(twice, pose_precision_recall([hand_verdicts()]))


def test_nothing_found_scores_nothing_and_nothing_to_find_is_unknown() -> None:
    blank = judge_poses(np.empty((0, 2)), np.empty(0), np.array([True, True]), 0.1)
    assert pose_average_precision(pose_precision_recall([blank])) == 0.0
    assert pose_average_precision(pose_precision_recall([blank], pooled=True)) == 0.0
    hidden = judge_poses(np.array([[0.0]]), np.array([0.5]), np.array([False]), 0.1)
    for pooled in (False, True):
        assert np.isnan(pose_average_precision(pose_precision_recall([hidden], pooled=pooled)))
    assert pose_precision_recall([hidden]).precision.tolist() == [1.0, 1.0]


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_truth_as_estimate_scores_one_by_both_criteria(part: PartModel) -> None:
    rng = np.random.default_rng(4)
    true = np.stack([at.random_pose(rng) for _ in range(8)])
    est = true[::-1] @ at.random_element(part, rng)
    to_find = np.arange(8) > 2
    by_surface = judge_poses(PoseSpace.of(part).distances(est, true), rng.random(8), to_find, MAX_DISTANCE * part.d_max)
    by_paper = judge_poses(recognition_distances(est, true, part), rng.random(8), to_find, np.inf)
    for verdicts in (by_surface, by_paper):
        assert verdicts.claims.tolist() == list(range(8))[::-1]
        assert pose_average_precision(pose_precision_recall([verdicts])) == 1.0
    away = make_transform(None, (0.0, 0.0, 1.01 * MAX_DISTANCE * part.d_max)) @ est
    missed = judge_poses(PoseSpace.of(part).distances(away, true), rng.random(8), to_find, MAX_DISTANCE * part.d_max)
    assert not missed.correct.any()
    assert not judge_poses(recognition_distances(away, true, part), rng.random(8), to_find, np.inf).correct.any()


@settings(deadline=None, max_examples=60)
@given(seeds)
def test_average_precision_agrees_with_the_papers_recount_at_every_score(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scenes = []
    for _ in range(rng.integers(1, 4)):
        truths = np.arange(rng.integers(1, 5), dtype=np.float64)  # a metre apart on a line
        estimates = rng.choice(truths, size=rng.integers(0, 8)) + rng.normal(0.0, 0.1, 1)[0]
        estimates = estimates + rng.normal(0.0, 0.08, len(estimates))
        to_find = rng.random(len(truths)) < 0.7
        to_find[0] = True
        scores = np.round(rng.random(len(estimates)), rng.choice([1, 6]))
        scenes.append((np.abs(estimates[:, None] - truths), scores, to_find))
    verdicts = [judge_poses(*scene, 0.1) for scene in scenes]
    area = pose_average_precision(pose_precision_recall(verdicts))
    assert area == pytest.approx(twin.average_precision(scenes, 0.1))
    assert 0.0 <= area <= 1.0


def test_visible_enough_includes_the_limit() -> None:
    assert visible_enough(np.array([0.49, 0.5, 1.0])).tolist() == [False, True, True]
    assert visible_enough(np.array([0.49, 0.5, 1.0]), 0.1).all()


def test_nonsense_is_refused() -> None:
    one, yes = np.array([0.5]), np.array([True])
    near = np.array([[0.0]])
    with pytest.raises(ValueError, match=r"distances must be \(1, 1\), got \(1, 2\)"):
        judge_poses(np.zeros((1, 2)), one, yes, 0.1)
    with pytest.raises(ValueError, match=r"scores must be \(N,\)"):
        judge_poses(near, one[None], yes, 0.1)
    with pytest.raises(ValueError, match=r"to_find must be \(N,\)"):
        judge_poses(near, one, yes[None], 0.1)
    for bad in (-1.0, np.nan):
        with pytest.raises(ValueError, match=r"distances must be 0 or more, and not NaN"):
            judge_poses(np.array([[bad]]), one, yes, 0.1)
    with pytest.raises(ValueError, match=r"max_distance must be positive, got 0"):
        judge_poses(near, one, yes, 0.0)
    with pytest.raises(ValueError, match=r"scores must be finite, got \[nan\]"):
        judge_poses(near, one * np.nan, yes, 0.1)
    with pytest.raises(ValueError, match=r"at least 1 scene is needed, got none"):
        pose_precision_recall([])


def test_verdicts_that_contradict_themselves_are_refused() -> None:
    fields = {"scores": np.zeros(1), "claims": np.zeros(1, np.int64), "to_find": 1}
    yes, no = np.ones(1, bool), np.zeros(1, bool)
    with pytest.raises(ValueError, match=r"excused must be \(1,\), got \(2,\)"):
        PoseVerdicts(correct=yes, excused=np.zeros(2, bool), **fields)
    with pytest.raises(ValueError, match=r"cannot be both correct and excused"):
        PoseVerdicts(correct=yes, excused=yes, **fields)
    with pytest.raises(ValueError, match=r"to_find must be at least the 1 found, got 0"):
        PoseVerdicts(correct=yes, excused=no, **(fields | {"to_find": 0}))


def test_the_curve_is_the_one_that_segments_have() -> None:
    curve = pose_precision_recall([hand_verdicts()])
    assert isinstance(curve, PrecisionRecall)
    assert (curve.precision[-1], curve.recall[-1], curve.scores[-1]) == (1.0, 0.0, np.inf)


def test_the_centroid_is_carried_by_the_pose() -> None:
    part = at.wedge()
    pose = at.random_pose(np.random.default_rng(0))
    space = PoseSpace.of(part)
    expected = transform_points(pose, surface_moments(part.mesh)[0][None])[0]
    np.testing.assert_allclose(space.representatives(pose)[0, -3:], expected, rtol=1e-12)
