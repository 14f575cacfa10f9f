"""The paper's criterion, ADD and ADD-S."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.geometry import make_transform, rotation_about
from perception.metrics.pose_errors import PoseError, add, add_s, is_recognised, pose_error, recognition_distances
from perception.part import PartModel
from tests.perception.pose import posed_parts as at
from tests.perception.pose.posed_parts import PARTS, Z

TWIN = Path(__file__).resolve().parents[2] / "reference" / "pose_error_twin.py"
twin = SimpleNamespace(**runpy.run_path(str(TWIN)))

AHEAD = make_transform(None, (0.0, 0.0, 1.0))
QUARTER = rotation_about(Z, np.pi / 2)
CUBE_CORNERS = np.asarray(at.cube().mesh.vertices)

parts = st.sampled_from(PARTS)
seeds = st.integers(0, 2**32 - 1)
sizes = st.sampled_from([0.0, 1e-9, 1e-4, 0.05, 1.0])
few = settings(deadline=None, max_examples=25)


def vertices(part: PartModel) -> np.ndarray:
    return np.asarray(part.mesh.vertices)


# The paper's criterion


def test_a_shift_is_a_translation_error_alone() -> None:
    error = pose_error(make_transform(None, (0.003, -0.004, 1.0)), AHEAD, at.wedge())
    assert error.translation == pytest.approx(0.005)
    assert error.rotation == 0.0


@pytest.mark.parametrize("degrees", [1e-6, 4.0, 90.0, 180.0])
def test_a_turn_about_the_centre_is_a_rotation_error_alone(degrees: float) -> None:
    part = at.wedge()
    turn = rotation_about((1.0, 2.0, -1.0), np.deg2rad(degrees))
    error = pose_error(AHEAD @ at.about_centre(part, turn), AHEAD, part)
    assert error.translation == pytest.approx(0.0, abs=1e-15)
    assert np.rad2deg(error.rotation) == pytest.approx(degrees)


def test_a_turn_about_the_drawings_origin_moves_the_centre() -> None:
    part = at.wedge()
    error = pose_error(AHEAD @ make_transform(at.HALF_TURN), AHEAD, part)
    assert error.translation == pytest.approx(2 * np.hypot(*part.centre[:2]))


def test_the_half_turn_of_a_lid_costs_nothing_and_a_quarter_costs_a_quarter() -> None:
    part = at.lid()
    half = pose_error(AHEAD @ at.about_centre(part, at.HALF_TURN), AHEAD, part)
    assert (half.translation, half.rotation) == pytest.approx((0.0, 0.0), abs=1e-12)
    quarter = pose_error(AHEAD @ at.about_centre(part, QUARTER), AHEAD, part)
    assert np.rad2deg(quarter.rotation) == pytest.approx(90.0)
    upside_down = pose_error(AHEAD @ at.about_centre(part, at.FLIP), AHEAD, part)
    assert np.rad2deg(upside_down.rotation) == pytest.approx(180.0)


@pytest.mark.parametrize(("part", "cost"), [(at.wheel(), 180.0), (at.rod(), 0.0)], ids=["wheel", "rod"])
def test_spin_of_a_solid_of_revolution_costs_nothing_and_flipped_ends_cost_if_they_differ(
    part: PartModel, cost: float
) -> None:
    spin = rotation_about(Z, 1.234)
    assert pose_error(AHEAD @ at.about_centre(part, spin), AHEAD, part).rotation == pytest.approx(0.0, abs=1e-12)
    flipped = pose_error(AHEAD @ at.about_centre(part, at.FLIP @ spin), AHEAD, part)
    assert np.rad2deg(flipped.rotation) == pytest.approx(cost, abs=1e-9)
    assert flipped.translation == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(
    ("millimetres", "degrees", "recognised"),
    [(0.0, 0.0, True), (7.9, 4.9, True), (8.1, 0.0, False), (0.0, 5.1, False), (8.1, 5.1, False)],
)
def test_the_papers_limits(millimetres: float, degrees: float, recognised: bool) -> None:
    error = PoseError(translation=millimetres / 1000, rotation=np.deg2rad(degrees))
    assert is_recognised(error, 0.08) is recognised


def test_the_limits_themselves_pass_and_can_be_set() -> None:
    assert is_recognised(PoseError(translation=0.10 * 0.08, rotation=np.deg2rad(5.0)), 0.08)
    error = PoseError(translation=0.010, rotation=0.2)
    assert not is_recognised(error, 0.08, max_translation=0.2)
    assert not is_recognised(error, 0.08, max_rotation=0.3)
    assert is_recognised(error, 0.08, max_translation=0.2, max_rotation=0.3)


@few
@given(parts, seeds, sizes)
def test_the_criterion_agrees_with_the_twin_and_sees_no_symmetry(part: PartModel, seed: int, size: float) -> None:
    a, b, _ = at.three_poses(part, seed, size)
    rng = np.random.default_rng(seed)
    error = pose_error(b, a, part)
    assert error.translation == pytest.approx(twin.translation_error(b, a, part.centre), abs=1e-12)
    group, step = part.symmetry.elements(360), 0.0 if part.symmetry.axis is None else np.pi / 360
    # An arc cosine is good to 1e-7 at best near no turn, and samples of an axis to half a step.
    sampled = twin.rotation_error(b, a, group)
    assert sampled - step - 1e-7 <= error.rotation <= sampled + 1e-7

    world = at.random_pose(rng)
    for moved in (pose_error(a, b, part), pose_error(world @ b, world @ a, part)):
        assert (moved.translation, moved.rotation) == pytest.approx((error.translation, error.rotation), abs=1e-9)
    unseen = pose_error(b @ at.random_element(part, rng), a @ at.random_element(part, rng), part)
    assert (unseen.translation, unseen.rotation) == pytest.approx((error.translation, error.rotation), abs=1e-9)


@few
@given(parts, seeds, sizes)
def test_both_halves_obey_the_triangle_inequality(part: PartModel, seed: int, size: float) -> None:
    a, b, c = at.three_poses(part, seed, size)
    direct, first, second = (pose_error(*pair, part) for pair in ((a, c), (a, b), (b, c)))
    assert direct.translation <= first.translation + second.translation + 1e-12
    assert direct.rotation <= first.rotation + second.rotation + 1e-9
    assert pose_error(a, a, part) == PoseError(translation=0.0, rotation=0.0)


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_recognition_distances_are_the_translations_that_pass(part: PartModel) -> None:
    rng = np.random.default_rng(5)
    true = np.stack([at.random_pose(rng) for _ in range(6)])
    est = np.stack([at.random_nearby(true[k], part, rng, s) for k in range(6) for s in (0.0, 0.03, 0.06, 0.1)])
    est = est @ at.random_element(part, rng)
    errors = [[pose_error(e, t, part) for t in true] for e in est]
    expected = [[e.translation if is_recognised(e, part.d_max) else np.inf for e in row] for row in errors]
    distances = recognition_distances(est, true, part)
    np.testing.assert_array_equal(distances, expected)
    assert np.isfinite(distances).any(axis=0).all()
    assert (distances.min(axis=1) == np.inf).any()
    wide = recognition_distances(est, true, part, max_translation=np.inf, max_rotation=np.inf)
    np.testing.assert_array_equal(wide, [[error.translation for error in row] for row in errors])
    assert recognition_distances(est[:0], true, part).shape == (0, 6)


# ADD and ADD-S


def test_add_of_a_cube_by_hand() -> None:
    h = 0.01
    quarter, half = make_transform(QUARTER), make_transform(at.HALF_TURN)
    assert add(quarter, np.eye(4), CUBE_CORNERS) == pytest.approx(2 * h)
    assert add(half, np.eye(4), CUBE_CORNERS) == pytest.approx(2 * np.sqrt(2) * h)
    assert add_s(quarter, np.eye(4), CUBE_CORNERS) == pytest.approx(0.0, abs=1e-15)
    shift = make_transform(None, (0.0, 0.002, 0.0))
    assert add(shift, np.eye(4), CUBE_CORNERS) == pytest.approx(0.002)
    assert add_s(shift, np.eye(4), CUBE_CORNERS) == pytest.approx(0.002)
    # 18 mm along an edge: four corners come to 2 mm before where others were, four are 18 mm from the nearest.
    assert add_s(make_transform(None, (0.018, 0.0, 0.0)), np.eye(4), CUBE_CORNERS) == pytest.approx(0.010)


def test_add_s_goes_from_the_truth_to_the_estimate() -> None:
    points = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.1, 0.0)])
    quarter = make_transform(QUARTER)  # now at (0, 0), (0, 1), (-0.1, 1)
    assert add_s(quarter, np.eye(4), points) == pytest.approx((0.0 + 1.0 + np.hypot(1.0, 0.1)) / 3)
    assert add_s(np.eye(4), quarter, points) == pytest.approx((0.0 + 1.0 + np.hypot(0.1, 1.0)) / 3)
    shift = make_transform(None, (1.0, 0.0, 0.0))  # at (1, 0), (2, 0), (2, 0.1)
    assert add_s(shift, np.eye(4), points) == pytest.approx((1.0 + 0.0 + 0.1) / 3)
    assert add_s(np.eye(4), shift, points) == pytest.approx((0.0 + 1.0 + 1.0) / 3)


@few
@given(parts, seeds, sizes)
def test_add_and_add_s_agree_with_the_twin(part: PartModel, seed: int, size: float) -> None:
    a, b, c = at.three_poses(part, seed, size)
    points, world = vertices(part), at.random_pose(np.random.default_rng(seed))
    assert add(b, a, points) == pytest.approx(twin.add(b, a, points), abs=1e-12)
    assert add_s(b, a, points) == pytest.approx(twin.add_s(b, a, points), abs=1e-12)
    assert add_s(b, a, points) <= add(b, a, points) + 1e-12
    assert add(world @ b, world @ a, points) == pytest.approx(add(b, a, points), abs=1e-12)
    assert add_s(world @ b, world @ a, points) == pytest.approx(add_s(b, a, points), abs=1e-12)
    assert add(a, b, points) == pytest.approx(add(b, a, points))
    assert add(a, c, points) <= add(a, b, points) + add(b, c, points) + 1e-12
    assert add(a, a, points) == add_s(a, a, points) == 0.0


# What is refused


def test_nonsense_is_refused() -> None:
    part, poses = at.wedge(), AHEAD[None]
    with pytest.raises(ValueError, match=r"translation must be 0 or more, got -1"):
        PoseError(translation=-1.0, rotation=0.0)
    with pytest.raises(ValueError, match=r"rotation must be 0 or more, got nan"):
        PoseError(translation=0.0, rotation=np.nan)
    error = PoseError(translation=0.0, rotation=0.0)
    with pytest.raises(ValueError, match=r"d_max must be positive, got 0"):
        is_recognised(error, 0.0)
    with pytest.raises(ValueError, match=r"limits must be 0 or more, got -0.1 of d_max"):
        is_recognised(error, 0.1, max_translation=-0.1)
    with pytest.raises(ValueError, match=r"limits must be 0 or more, got 0.1 of d_max and -1"):
        is_recognised(error, 0.1, max_rotation=-1.0)
    with pytest.raises(ValueError, match=r"T_est must be \(N, 4, 4\), got \(4, 4\)"):
        recognition_distances(AHEAD, poses, part)
    with pytest.raises(ValueError, match=r"T_true must be \(N, 4, 4\), got \(4, 4\)"):
        recognition_distances(poses, AHEAD, part)
    for pair, name in (((poses * np.nan, poses), "T_est"), ((poses, poses * np.nan), "T_true")):
        with pytest.raises(ValueError, match=rf"{name} must be finite, got \[\[\[nan"):
            recognition_distances(*pair, part)
    with pytest.raises(ValueError, match=r"limits must be 0 or more, got -1.0 of d_max"):
        recognition_distances(poses, poses, part, max_translation=-1.0)
    with pytest.raises(ValueError, match=r"at least one point, got none"):
        add(AHEAD, AHEAD, np.empty((0, 3)))
    with pytest.raises(ValueError, match=r"points must be \(N, 3\)"):
        add_s(AHEAD, AHEAD, np.empty((3, 2)))


@pytest.mark.parametrize("name", ["T_est", "T_true"])
def test_poses_that_are_none_are_refused(name: str) -> None:
    part = at.wedge()
    for call in (
        lambda a, b: pose_error(a, b, part),
        lambda a, b: add(a, b, CUBE_CORNERS),
        lambda a, b: add_s(a, b, CUBE_CORNERS),
    ):
        for bad, text in ((AHEAD[:3], r"must be \(4, 4\), got \(3, 4\)"), (AHEAD * np.nan, "must be finite, got")):
            pair = (bad, AHEAD) if name == "T_est" else (AHEAD, bad)
            with pytest.raises(ValueError, match=rf"{name} {text}"):
                call(*pair)
