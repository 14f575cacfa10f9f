"""The three errors of BOP, and the recall averaged over their thresholds."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.geometry import make_transform, rotation_about
from perception.metrics.bop_error import SHARES, VsdTolerances, average_recall, mspd, mssd, vsd
from perception.part import PartModel, Symmetry
from tests.perception.pose import posed_parts as at
from tests.perception.pose.posed_parts import PARTS, K, X, Z

TWIN = Path(__file__).resolve().parents[2] / "reference" / "pose_error_twin.py"
twin = SimpleNamespace(**runpy.run_path(str(TWIN)))

AHEAD = make_transform(None, (0.0, 0.0, 1.0))
QUARTER = rotation_about(Z, np.pi / 2)
QUARTERS = Symmetry(rotations=np.stack([rotation_about(Z, k * np.pi / 2) for k in range(4)]))
FAR_CAMERA = np.array([[1e9, 0.0, 0.0], [0.0, 1e9, 0.0], [0.0, 0.0, 1.0]])  # all rays along z

parts = st.sampled_from(PARTS)
seeds = st.integers(0, 2**32 - 1)
sizes = st.sampled_from([0.0, 1e-4, 0.05, 1.0])
few = settings(deadline=None, max_examples=25)


def vertices(part: PartModel) -> np.ndarray:
    return np.asarray(part.mesh.vertices)


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


@pytest.mark.parametrize("degrees", [7.3, 7.7])  # on either side of the nearest angle that is tried
@pytest.mark.parametrize(("part", "free"), [(at.wheel(), False), (at.rod(), True)], ids=["wheel", "rod"])
def test_spin_costs_neither_mssd_nor_mspd_and_flipped_ends_do_if_they_differ(
    part: PartModel, free: bool, degrees: float
) -> None:
    spun = AHEAD @ at.about_centre(part, rotation_about(Z, np.deg2rad(degrees)))
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
    a, b, _ = at.three_poses(part, seed, size)
    steps = 36
    group, points = part.symmetry.elements(steps), vertices(part)
    radius = np.linalg.norm((points - part.centre)[:, :2], axis=1).max()
    stated = 0.0 if part.symmetry.axis is None else 2 * radius * np.sin(np.pi / (2 * steps))
    sampled = twin.mssd(b, a, points, group, part.centre)
    assert sampled - stated - 1e-9 <= mssd(b, a, part, steps=steps) <= sampled + 1e-9
    pixels = twin.mspd(b, a, points, group, part.centre, K)
    assert pixels - 1e3 * stated - 1e-9 <= mspd(b, a, part, K, steps=steps) <= pixels + 1e-9


@settings(deadline=None, max_examples=8)
@given(parts, seeds, sizes)
def test_mssd_is_a_metric_that_sees_no_symmetry(part: PartModel, seed: int, size: float) -> None:
    a, b, c = at.three_poses(part, seed, size)
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
    assert vsd(quarter, one, row(0.0), FAR_CAMERA, 1.0, VsdTolerances(taus=(0.25, 0.26))).tolist() == [1.0, 0.0]


def test_vsd_sees_through_holes_but_not_through_what_lies_in_front() -> None:
    scene = row(0.0, np.nan, 0.98, 0.99, 2.0)
    true = row(1.0, 1.0, 1.0, 1.0, 0.0)
    est = row(1.0, 1.0, 1.0, 0.0, 0.0)
    # The third pixel is 20 mm behind the scene: hidden in both. Of the other three the estimate lacks one.
    assert vsd(est, true, scene, FAR_CAMERA, 1.0) == pytest.approx(np.full(10, 1 / 3))
    assert vsd(est, true, scene, FAR_CAMERA, 1.0, VsdTolerances(delta=0.03)) == pytest.approx(np.full(10, 1 / 4))


def test_vsd_lets_the_estimate_lie_behind_the_part_itself() -> None:
    true, est = row(1.0, 0.0), row(1.04, 1.04)
    scene = row(1.0, 1.0)
    # The first pixel is of the true part, which hides the estimate; the second is hidden by something else.
    assert vsd(est, true, scene, FAR_CAMERA, 1.0) == pytest.approx(np.zeros(10))


def test_vsd_measures_along_the_ray() -> None:
    K45 = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])  # the only pixel looks 45 degrees aside
    errors = vsd(row(1.01), row(1.0), row(0.0), K45, 1.0, VsdTolerances(taus=(0.013, 0.015)))
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
    part = at.wedge()
    with pytest.raises(ValueError, match=r"steps must be at least 1, got 0"):
        mssd(AHEAD, AHEAD, part, steps=0)
    with pytest.raises(ValueError, match=r"K must be \(3, 3\)"):
        mspd(AHEAD, AHEAD, part, K[:2])
    with pytest.raises(ValueError, match=r"in front of the camera, got z = -"):
        mspd(AHEAD, np.diag([1.0, -1.0, -1.0, 1.0]), part, K)
    with pytest.raises(ValueError, match=r"at least 1 error and 1 threshold are needed, got 0 and 10"):
        average_recall(np.empty(0), SHARES)
    with pytest.raises(ValueError, match=r"at least 1 error and 1 threshold are needed, got 2 and 0"):
        average_recall(np.zeros(2), ())
    with pytest.raises(ValueError, match=r"errors must not be NaN"):
        average_recall(np.array([np.nan]), SHARES)


@pytest.mark.parametrize("name", ["T_est", "T_true"])
def test_poses_that_are_none_are_refused(name: str) -> None:
    part = at.wedge()
    for call in (lambda a, b: mssd(a, b, part), lambda a, b: mspd(a, b, part, K)):
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
        vsd(one, one, one, K, 1.0, VsdTolerances(taus=(0.0,)))
    with pytest.raises(ValueError, match=r"taus must be positive and delta 0 or more, got .* and -1"):
        vsd(one, one, one, K, 1.0, VsdTolerances(delta=-1.0))
    with pytest.raises(ValueError, match=r"depth_est must be \(N, N\), got \(1,\)"):
        vsd(one[0], one, one, K, 1.0)
    with pytest.raises(ValueError, match=r"depth_true must be \(1, 1\), got \(1, 2\)"):
        vsd(one, two, one, K, 1.0)
    with pytest.raises(ValueError, match=r"depth_scene must be \(1, 1\), got \(1, 2\)"):
        vsd(one, one, two, K, 1.0)
