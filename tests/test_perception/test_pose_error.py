"""The paper's criterion, ADD and ADD-S, and the three errors of BOP."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import posed_parts as at
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from posed_parts import PARTS, K, X, Z

from perception.geometry import make_transform, rotation_about
from perception.metrics.bop_error import SHARES, average_recall, mspd, mssd, vsd
from perception.metrics.pose_error import PoseError, add, add_s, is_recognised, pose_error, recognition_distances
from perception.part import PartModel, Symmetry

TWIN = Path(__file__).resolve().parents[1] / "reference" / "pose_error_twin.py"
twin = SimpleNamespace(**runpy.run_path(str(TWIN)))

AHEAD = make_transform(None, (0.0, 0.0, 1.0))
QUARTER = rotation_about(Z, np.pi / 2)
QUARTERS = Symmetry(rotations=np.stack([rotation_about(Z, k * np.pi / 2) for k in range(4)]))
CUBE_CORNERS = np.asarray(at.cube().mesh.vertices)
FAR_CAMERA = np.array([[1e9, 0.0, 0.0], [0.0, 1e9, 0.0], [0.0, 0.0, 1.0]])  # all rays along z

parts = st.sampled_from(PARTS)
seeds = st.integers(0, 2**32 - 1)
sizes = st.sampled_from([0.0, 1e-9, 1e-4, 0.05, 1.0])
few = settings(deadline=None, max_examples=25)


def three_poses(part: PartModel, seed: int, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    a = at.random_pose(rng)
    return a, at.random_nearby(a, part, rng, size), at.random_nearby(a, part, rng, size)


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
    a, b, _ = three_poses(part, seed, size)
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
    a, b, c = three_poses(part, seed, size)
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
    a, b, c = three_poses(part, seed, size)
    points, world = vertices(part), at.random_pose(np.random.default_rng(seed))
    assert add(b, a, points) == pytest.approx(twin.add(b, a, points), abs=1e-12)
    assert add_s(b, a, points) == pytest.approx(twin.add_s(b, a, points), abs=1e-12)
    assert add_s(b, a, points) <= add(b, a, points) + 1e-12
    assert add(world @ b, world @ a, points) == pytest.approx(add(b, a, points), abs=1e-12)
    assert add_s(world @ b, world @ a, points) == pytest.approx(add_s(b, a, points), abs=1e-12)
    assert add(a, b, points) == pytest.approx(add(b, a, points))
    assert add(a, c, points) <= add(a, b, points) + add(b, c, points) + 1e-12
    assert add(a, a, points) == add_s(a, a, points) == 0.0


# MSSD and MSPD


def test_mssd_of_a_cube_by_hand() -> None:
    h, quarter = 0.01, AHEAD @ make_transform(QUARTER)
    assert mssd(quarter, AHEAD, at.cube()) == pytest.approx(2 * h)
    assert mssd(quarter, AHEAD, at.cube(QUARTERS)) == pytest.approx(0.0, abs=1e-15)
    eighth = AHEAD @ make_transform(rotation_about(Z, np.pi / 4))
    assert mssd(eighth, AHEAD, at.cube(QUARTERS)) == pytest.approx(2 * np.sqrt(2) * h * np.sin(np.pi / 8))
    shift = make_transform(None, (0.0, 0.003, 1.004))
    assert mssd(shift, AHEAD, at.cube(QUARTERS)) == pytest.approx(0.005)


def test_mspd_of_a_cube_by_hand() -> None:
    h, shift = 0.01, make_transform(None, (0.002, 0.0, 1.0))
    assert mspd(shift, AHEAD, at.cube(QUARTERS), K) == pytest.approx(600 * 0.002 / (1 - h))
    upwards = make_transform(None, (0.0, 0.002, 1.0))
    assert mspd(upwards, AHEAD, at.cube(QUARTERS), K) == pytest.approx(620 * 0.002 / (1 - h))
    quarter = AHEAD @ make_transform(QUARTER)
    assert mspd(quarter, AHEAD, at.cube(QUARTERS), K) == pytest.approx(0.0, abs=1e-9)
    assert mspd(quarter, AHEAD, at.cube(), K) == pytest.approx(620 * 2 * h / (1 - h))
    assert mspd(make_transform(None, (0.0, 0.0, -1.0)), AHEAD, at.cube(), K) == np.inf


@pytest.mark.parametrize(("part", "free"), [(at.wheel(), False), (at.rod(), True)], ids=["wheel", "rod"])
def test_spin_costs_neither_mssd_nor_mspd_and_flipped_ends_do_if_they_differ(part: PartModel, free: bool) -> None:
    spun = AHEAD @ at.about_centre(part, rotation_about(Z, 0.1234))  # between two of the angles tried
    assert mssd(spun, AHEAD, part) == pytest.approx(0.0, abs=1e-9)
    assert mspd(spun, AHEAD, part, K) == pytest.approx(0.0, abs=1e-5)
    flipped = AHEAD @ at.about_centre(part, at.FLIP)
    if free:
        assert mssd(flipped, AHEAD, part) == pytest.approx(0.0, abs=1e-9)
        assert mspd(flipped, AHEAD, part, K) == pytest.approx(0.0, abs=1e-5)
    else:
        assert mssd(flipped, AHEAD, part) > 0.01
        assert mspd(flipped, AHEAD, part, K) > 5.0


@settings(deadline=None, max_examples=8)
@given(parts, seeds, sizes)
def test_mssd_and_mspd_agree_with_the_twin(part: PartModel, seed: int, size: float) -> None:
    a, b, _ = three_poses(part, seed, size)
    steps = 36
    group, points = part.symmetry.elements(steps), vertices(part)
    radius = np.linalg.norm((points - part.centre)[:, :2], axis=1).max()
    stated = 0.0 if part.symmetry.axis is None else 2 * radius * np.sin(np.pi / (2 * steps))
    sampled = twin.mssd(b, a, points, group, part.centre)
    assert sampled - stated - 1e-9 <= mssd(b, a, part, steps=steps) <= sampled + 1e-9
    pixels = twin.mspd(b, a, points, group, part.centre, K)
    assert pixels - 1e3 * stated - 1e-9 <= mspd(b, a, part, K, steps=steps) <= pixels + 1e-9


@settings(deadline=None, max_examples=8)
@given(parts, seeds, st.sampled_from([0.0, 1e-4, 0.05, 1.0]))
def test_mssd_is_a_metric_that_sees_no_symmetry(part: PartModel, seed: int, size: float) -> None:
    a, b, c = three_poses(part, seed, size)
    rng = np.random.default_rng(seed)
    # The refined minimum about an axis need not be the least one: the facets' group is exact and finite.
    if part.symmetry.axis is not None:
        part = PartModel.from_mesh(part.name, part.mesh, Symmetry(rotations=part.symmetry.elements(12)))
    error, world = mssd(b, a, part), at.random_pose(rng)
    assert mssd(a, b, part) == pytest.approx(error, abs=1e-9)
    assert mssd(world @ b, world @ a, part) == pytest.approx(error, abs=1e-9)
    assert mssd(b @ at.random_element(part, rng), a @ at.random_element(part, rng), part) == pytest.approx(
        error, abs=1e-9
    )
    assert mssd(a, c, part) <= error + mssd(b, c, part) + 1e-9
    assert mssd(a, a, part) == pytest.approx(0.0, abs=1e-15)


def test_steps_reach_the_angles_tried() -> None:
    part = at.wheel(sections=7)
    tilted = AHEAD @ at.about_centre(part, rotation_about(X, 0.6) @ rotation_about(Z, 2.0))
    fine = mssd(tilted, AHEAD, part)
    assert fine <= mssd(tilted, AHEAD, part, steps=1) + 1e-9
    assert fine == pytest.approx(mssd(tilted, AHEAD, part, steps=3600), abs=1e-6)


# VSD


def row(*depths: float) -> np.ndarray:
    return np.array([depths], np.float32)


def test_vsd_by_hand() -> None:
    scene = row(2.0, 2.0, 2.0, 2.0, 2.0)
    true = row(1.0, 1.0, 1.0, 0.0, 0.0)
    assert vsd(true, true, np.minimum(scene, 1.0), FAR_CAMERA, 1.0) == pytest.approx(np.zeros(10))
    shifted = row(0.0, 1.0, 1.0, 1.0, 0.0)  # four pixels in the union, two of them in both
    assert vsd(shifted, true, scene, FAR_CAMERA, 1.0) == pytest.approx(np.full(10, 0.5))
    deeper = row(1.0, 1.07, 1.28, 0.0, 0.0)
    by_tau = vsd(deeper, true, scene, FAR_CAMERA, 1.0)
    assert by_tau == pytest.approx([2 / 3] + [1 / 3] * 4 + [0.0] * 5)
    assert vsd(deeper, true, scene, FAR_CAMERA, 0.1) == pytest.approx(np.full(10, 2 / 3))
    assert vsd(true, row(0, 0, 0, 0, 0), row(0.5, 0.5, 0.5, 0.5, 0.5), FAR_CAMERA, 1.0) == pytest.approx(np.ones(10))


def test_vsd_is_strict_at_the_tolerance() -> None:
    one, quarter = row(1.0), row(1.25)
    assert vsd(quarter, one, row(0.0), FAR_CAMERA, 1.0, taus=(0.25, 0.26)).tolist() == [1.0, 0.0]


def test_vsd_sees_through_holes_but_not_through_what_lies_in_front() -> None:
    scene = row(0.0, np.nan, 0.98, 0.99, 2.0)
    true = row(1.0, 1.0, 1.0, 1.0, 0.0)
    est = row(1.0, 1.0, 1.0, 0.0, 0.0)
    # The third pixel is 20 mm behind the scene: hidden in both. Of the other three the estimate lacks one.
    assert vsd(est, true, scene, FAR_CAMERA, 1.0) == pytest.approx(np.full(10, 1 / 3))
    assert vsd(est, true, scene, FAR_CAMERA, 1.0, delta=0.03) == pytest.approx(np.full(10, 1 / 4))


def test_vsd_lets_the_estimate_lie_behind_the_part_itself() -> None:
    true, est = row(1.0, 0.0), row(1.04, 1.04)
    scene = row(1.0, 1.0)
    # The first pixel is of the true part, which hides the estimate; the second is hidden by something else.
    assert vsd(est, true, scene, FAR_CAMERA, 1.0) == pytest.approx(np.zeros(10))


def test_vsd_measures_along_the_ray() -> None:
    K45 = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])  # the only pixel looks 45 degrees aside
    errors = vsd(row(1.01), row(1.0), row(0.0), K45, 1.0, taus=(0.013, 0.015))
    assert errors.tolist() == [1.0, 0.0]
    behind = vsd(row(1.0), row(1.0), row(0.988), K45, 1.0)  # 17 mm along the ray: hidden
    assert behind == pytest.approx(np.ones(10))


@few
@given(seeds)
def test_vsd_agrees_with_the_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = np.array([[5.0, 0.0, 2.0], [0.0, 6.0, 1.0], [0.0, 0.0, 1.0]])
    images = rng.uniform(0.95, 1.05, (3, 4, 6)) * (rng.random((3, 4, 6)) < 0.8)
    errors = vsd(*images, camera, 0.1)
    assert errors == pytest.approx([twin.vsd(*images, camera, tau * 0.1, 0.015) for tau in SHARES])
    assert (np.diff(errors) <= 0).all()
    assert ((errors >= 0) & (errors <= 1)).all()


def test_average_recall_by_hand() -> None:
    assert SHARES == (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5)
    assert average_recall(np.array([0.0, 0.12, np.inf]), SHARES) == pytest.approx((10 + 8) / 30)
    assert average_recall(np.array([0.1]), (0.1, 0.2)) == 0.5  # strict
    assert average_recall(np.zeros((3, 10)), SHARES) == 1.0


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
    with pytest.raises(ValueError, match=r"steps must be at least 1, got 0"):
        mssd(AHEAD, AHEAD, part, steps=0)
    with pytest.raises(ValueError, match=r"K must be \(3, 3\)"):
        mspd(AHEAD, AHEAD, part, K[:2])
    with pytest.raises(ValueError, match=r"in front of the camera, got z = -"):
        mspd(AHEAD, np.diag([1.0, -1.0, -1.0, 1.0]), part, K)
    with pytest.raises(ValueError, match=r"at least one point, got none"):
        add(AHEAD, AHEAD, np.empty((0, 3)))
    with pytest.raises(ValueError, match=r"points must be \(N, 3\)"):
        add_s(AHEAD, AHEAD, np.empty((3, 2)))
    with pytest.raises(ValueError, match=r"at least 1 error and 1 threshold are needed, got 0 and 10"):
        average_recall(np.empty(0), SHARES)
    with pytest.raises(ValueError, match=r"at least 1 error and 1 threshold are needed, got 2 and 0"):
        average_recall(np.zeros(2), ())
    with pytest.raises(ValueError, match=r"errors must not be NaN"):
        average_recall(np.array([np.nan]), SHARES)


@pytest.mark.parametrize("name", ["T_est", "T_true"])
def test_poses_that_are_none_are_refused(name: str) -> None:
    part = at.wedge()
    for call in (
        lambda a, b: pose_error(a, b, part),
        lambda a, b: add(a, b, CUBE_CORNERS),
        lambda a, b: add_s(a, b, CUBE_CORNERS),
        lambda a, b: mssd(a, b, part),
        lambda a, b: mspd(a, b, part, K),
    ):
        for bad, text in ((AHEAD[:3], r"must be \(4, 4\), got \(3, 4\)"), (AHEAD * np.nan, "must be finite, got")):
            pair = (bad, AHEAD) if name == "T_est" else (AHEAD, bad)
            with pytest.raises(ValueError, match=rf"{name} {text}"):
                call(*pair)


def test_vsd_refuses_nonsense() -> None:
    one, two = row(1.0), row(1.0, 1.0)
    with pytest.raises(ValueError, match=r"K must be \(3, 3\)"):
        vsd(one, one, one, K[0], 1.0)
    with pytest.raises(ValueError, match=r"d_max must be positive, got -1"):
        vsd(one, one, one, K, -1.0)
    with pytest.raises(ValueError, match=r"taus must be positive and delta 0 or more, got \(0.0,\) and 0.015"):
        vsd(one, one, one, K, 1.0, taus=(0.0,))
    with pytest.raises(ValueError, match=r"taus must be positive and delta 0 or more, got .* and -1"):
        vsd(one, one, one, K, 1.0, delta=-1.0)
    with pytest.raises(ValueError, match=r"depth_est must be \(N, N\), got \(1,\)"):
        vsd(one[0], one, one, K, 1.0)
    with pytest.raises(ValueError, match=r"depth_true must be \(1, 1\), got \(1, 2\)"):
        vsd(one, two, one, K, 1.0)
    with pytest.raises(ValueError, match=r"depth_scene must be \(1, 1\), got \(1, 2\)"):
        vsd(one, one, two, K, 1.0)
