"""Steps, motions and whole descents, compiled, against NumPy, SciPy and plain loops."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.geometry import Floats, make_transform, random_rotation, rotation_about
from perception.pose.model.surface_models import surface_model
from perception.pose.verification import _descent_kernels as kernels
from perception.pose.verification._refine_kernels import line_equations
from perception.pose.verification.boundary_index import index_boundary
from tests.perception.pose import observed_part as at
from tests.perception.pose.observed_part import SIGMA, K
from tests.reference import refine_twin as twin

ELL = at.ell()
MODEL = at.all_visible(*at.wires(ELL, 0.01), ELL)
SURFACE = surface_model(ELL, 0.06)
LEANING = at.pose_of(ELL, rotation_about((1.0, 1.0, 0.0), 0.7) @ rotation_about((1.0, 0.0, 0.0), np.pi))
ARM = ELL.d_max / 2
SEEDS = st.integers(0, 2**32 - 1)


def random_equations(rng: np.random.Generator, rank: int) -> tuple[Floats, Floats]:
    """Return J'J and J'e of a Jacobian that tells so many freedoms."""
    J = rng.normal(size=(20, rank)) @ rng.normal(size=(rank, 6))
    return J.T @ J, J.T @ rng.normal(size=20)


# One step


@settings(deadline=None, max_examples=60)
@given(SEEDS, st.integers(0, 6), st.sampled_from([0.0, 1e-3, 1.0]), st.sampled_from([0.0, 5e-3, 5.0]))
def test_a_step_is_that_of_the_twin(seed: int, rank: int, damping: float, observable: float) -> None:
    hessian, gradient = random_equations(np.random.default_rng(seed), rank)
    if rank < 6 and observable == 0.0:
        observable = 1e-6  # what rounding leaves of a freedom that is none is not the same in both
    motion = kernels.gauss_newton_step(hessian, gradient, damping, observable)
    np.testing.assert_allclose(motion, twin.gauss_newton_step(hessian, gradient, damping, observable), atol=1e-8)


def test_a_step_without_damping_solves_the_equations() -> None:
    hessian, gradient = random_equations(np.random.default_rng(0), 6)
    np.testing.assert_allclose(
        kernels.gauss_newton_step(hessian, gradient, 0.0, 0.0), -np.linalg.solve(hessian, gradient), rtol=1e-8
    )


def test_a_freedom_that_is_not_told_does_not_move() -> None:
    hessian, gradient = np.diag([1.0, 2.0, 0.0, 4.0, 1e-4, 5e-3]), np.ones(6)
    expected = [-1.0, -0.5, 0.0, -0.25, 0.0, 0.0]
    np.testing.assert_allclose(kernels.gauss_newton_step(hessian, gradient, 0.0, 5e-3), expected, atol=1e-12)
    damped = kernels.gauss_newton_step(hessian, gradient, 1.0, 5e-3)
    np.testing.assert_allclose(damped, [-1 / 2, -1 / 3, 0.0, -1 / 5, 0.0, 0.0], atol=1e-12)
    assert not kernels.gauss_newton_step(np.zeros((6, 6)), np.ones(6), 0.0, 0.0).any()


# One motion


@settings(deadline=None, max_examples=80)
@given(SEEDS, st.sampled_from([0.0, 1e-14, 1e-9, 9e-5, 1.1e-4, 1e-2, 1.0, np.pi, 6.0]))
def test_a_motion_is_that_of_scipy(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    T = make_transform(random_rotation(rng), rng.normal(size=3))
    axis, arm, pivot = rng.normal(size=3), rng.uniform(0.01, 0.1), rng.normal(size=3)
    motion = np.concatenate([axis / np.linalg.norm(axis) * angle * arm, 0.1 * rng.normal(size=3)])
    found = kernels.moved(T, motion, pivot, arm)
    np.testing.assert_allclose(found, twin.moved(T, motion, pivot, arm), atol=1e-12)
    np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-12)


def test_a_quarter_turn_about_a_point_and_a_shift_by_hand() -> None:
    motion = np.array([0.0, 0.0, 0.04 * np.pi / 2, 0.1, 0.2, 0.3])
    found = kernels.moved(make_transform(None, (2.0, 1.0, 5.0)), motion, np.array([1.0, 1.0, 0.0]), 0.04)
    expected = [[0, -1, 0, 1.1], [1, 0, 0, 2.2], [0, 0, 1, 5.3], [0, 0, 0, 1]]
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_no_motion_changes_nothing() -> None:
    np.testing.assert_allclose(kernels.moved(LEANING, np.zeros(6), np.ones(3), ARM), LEANING, rtol=0, atol=1e-15)


# Whole descents


SETTINGS = {"damping": 1e-3, "observable": 5e-3, "still": 1e-5}


def descend_edges(
    T: Floats, scene: tuple[Floats, Floats], iterations: int, gate: float = 0.004, **change: float
) -> Any:
    index = index_boundary(*scene, ELL.d_max)
    rest = (ELL.centre, ELL.d_max, iterations, *(SETTINGS | change).values())
    return kernels.descend_edges(T, MODEL.points, MODEL.tangents, *index.arrays, gate, np.cos(0.4), *rest)


@pytest.mark.parametrize("iterations", [0, 1, 3])
@pytest.mark.parametrize("seed", range(3))
def test_a_descent_on_edges_is_that_of_the_twin(seed: int, iterations: int) -> None:
    rng = np.random.default_rng(seed)
    points, tangents = (a[::9] for a in at.wire_scene(LEANING, ELL, rng, noise=SIGMA))
    start = at.beside(LEANING, ELL, rng, 0.002, 0.04)
    T, steps, settled, total, count = descend_edges(start, (points, tangents), iterations)

    def equations(T: Floats, pivot: Floats) -> Any:
        matches = twin.match_edges(T, MODEL.points, MODEL.tangents, points, tangents, 0.004, np.cos(0.4))
        return twin.line_equations(T, MODEL.points, matches, points, tangents, pivot, ARM)

    expected = twin.descended(start, equations, ELL.centre, ARM, iterations, *SETTINGS.values())
    np.testing.assert_allclose(T, expected[0], atol=1e-10)
    assert (steps, count) == (expected[1], expected[4])
    assert total == pytest.approx(expected[3], rel=1e-6)
    assert settled == (expected[2] < kernels.SETTLED)
    assert steps == iterations
    assert count > 20


@pytest.mark.parametrize("iterations", [0, 1, 3])
def test_a_descent_on_the_surface_is_that_of_the_twin(iterations: int) -> None:
    frame = at.look_at(at.placed(ELL, LEANING), noise=SIGMA)
    start = at.beside(LEANING, ELL, np.random.default_rng(0), 0.0005, 0.02)
    visible = SURFACE.visible(start)
    arguments = SURFACE.points, SURFACE.normals, visible, frame.depth, K, 0.004, np.cos(0.7), 3
    T, steps, settled, total, count = kernels.descend_surface(
        start, *arguments, ELL.centre, ELL.d_max, iterations, *SETTINGS.values()
    )
    expected = twin.descended(
        start, lambda T, pivot: twin.plane_equations(T, *arguments, pivot, ARM), ELL.centre, ARM, iterations,
        *SETTINGS.values(),
    )  # fmt: skip
    np.testing.assert_allclose(T, expected[0], atol=1e-8)
    assert (steps, count) == (expected[1], expected[4])
    assert total == pytest.approx(expected[3], rel=1e-5)
    assert settled == (expected[2] < kernels.SETTLED)
    assert count > 30


def test_a_descent_ends_with_a_step_that_is_still() -> None:
    scene = at.wire_scene(LEANING, ELL, np.random.default_rng(0))
    start = at.beside(LEANING, ELL, np.random.default_rng(1), 0.001, 0.02)
    _, hasty, settled, _, _ = descend_edges(start, scene, 50, still=1e-2)
    _, patient, _, total, count = descend_edges(start, scene, 50, still=1e-9)
    assert 1 <= hasty < patient < 50
    assert settled
    assert np.sqrt(total / count) < 1e-6


def test_a_long_last_step_is_not_settled() -> None:
    scene = at.wire_scene(LEANING, ELL, np.random.default_rng(0))
    start = make_transform(None, (0.0, 0.0, 0.002)) @ LEANING
    _, steps, settled, _, count = descend_edges(start, scene, 1)
    assert (steps, settled) == (1, False)
    assert count > 20


def test_five_matches_are_too_few() -> None:
    place = MODEL.points @ LEANING[:3, :3].T + LEANING[:3, 3]
    along = MODEL.tangents @ LEANING[:3, :3].T
    start = make_transform(None, (0.0, 0.0, 0.0003)) @ LEANING
    for enough, count in ((False, 5), (True, 6)):
        chosen = slice(0, 3 * count, 3)
        T, steps, settled, _, matched = descend_edges(start, (place[chosen], along[chosen]), 4, gate=0.001)
        assert matched == count
        assert (steps > 0, settled) == (enough, enough)
        assert (T.tobytes() == start.tobytes()) != enough


def test_the_start_is_not_changed() -> None:
    scene = at.wire_scene(LEANING, ELL, np.random.default_rng(0))
    start = at.beside(LEANING, ELL, np.random.default_rng(1), 0.001, 0.02)
    before = start.copy()
    descend_edges(start, scene, 5)
    np.testing.assert_array_equal(start, before)


def test_a_step_lowers_the_distances() -> None:
    rng = np.random.default_rng(3)
    points, tangents = at.wire_scene(LEANING, ELL, rng, noise=SIGMA)
    start = at.beside(LEANING, ELL, rng, 0.002, 0.03)
    matches = twin.match_edges(start, MODEL.points, MODEL.tangents, points, tangents, 0.01, 0.9)
    pivot = start[:3, :3] @ ELL.centre + start[:3, 3]
    H, g, before, count = line_equations(start, MODEL.points, matches, points, tangents, pivot, ARM)
    T = kernels.moved(start, kernels.gauss_newton_step(H / count, g / count, 1e-3, 5e-3), pivot, ARM)
    after = line_equations(T, MODEL.points, matches, points, tangents, pivot, ARM)[2]
    assert after < 0.2 * before
