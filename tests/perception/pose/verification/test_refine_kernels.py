"""Normal equations of edges and surfaces against plain twins and small differences, and measured normals."""

import numpy as np
import pytest

from perception.geometry import Floats, make_transform, rotation_about
from perception.pose.model.surface_models import surface_model
from perception.pose.verification import _refine_kernels as kernels
from tests.perception.pose import observed_part as at
from tests.perception.pose.observed_part import SIGMA, K
from tests.reference import refine_twin as twin

Z = np.array([0.0, 0.0, 1.0])
ELL = at.ell()
MODEL = at.wire_model(ELL)
SURFACE = surface_model(ELL)
LEANING = at.pose_of(ELL, rotation_about((1.0, 1.0, 0.0), 0.7) @ rotation_about((1.0, 0.0, 0.0), np.pi))


def test_line_equations_are_those_of_the_twin_and_of_small_differences() -> None:
    rng = np.random.default_rng(0)
    points, tangents = at.scattered(rng)
    tangents[::7] = Z
    matches = rng.integers(-1, len(points), len(MODEL))
    rest = (matches, points, tangents, np.array([0.01, 0.02, 0.5]), 0.04)
    H, g, total, count = kernels.line_equations(LEANING, MODEL.points, *rest)
    for have, want in zip((H, g, total, count), twin.line_equations(LEANING, MODEL.points, *rest), strict=True):
        np.testing.assert_allclose(have, want, rtol=1e-9)
    for i in range(6):
        values = [
            kernels.line_equations(nudged(LEANING, i, step, rest[3], rest[4]), MODEL.points, *rest)[2]
            for step in (-1e-6, 1e-6)
        ]
        assert (values[1] - values[0]) / 4e-6 == pytest.approx(g[i], rel=1e-5, abs=1e-9)


def nudged(T: Floats, freedom: int, step: float, centre: Floats, arm: float) -> Floats:
    """Return ``T`` after a small motion in one of six freedoms."""
    if freedom >= 3:
        return make_transform(None, step * np.eye(3)[freedom - 3]) @ T
    turn = rotation_about(np.eye(3)[freedom], step / arm)
    return make_transform(turn, centre - turn @ centre) @ T


def test_plane_equations_are_those_of_the_twin() -> None:
    frame = at.look_at(at.placed(ELL, LEANING), noise=SIGMA)
    depth = frame.depth.copy()
    depth[::9] = 0.0
    visible = SURFACE.visible(LEANING)
    start = at.beside(LEANING, ELL, np.random.default_rng(0), 0.001, 0.03)
    for aside in (0.0, 0.08):
        T = make_transform(None, (aside, 0.0, 0.0)) @ start
        rest = (visible, depth, K, 0.002, np.cos(0.7), 3, np.array([0.01, 0.02, 0.5]), 0.04)
        have = kernels.plane_equations(T, SURFACE.points, SURFACE.normals, *rest)
        want = twin.plane_equations(T, SURFACE.points, SURFACE.normals, *rest)
        for a, b in zip(have, want, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-12)
        assert aside or have[3] > 100


def test_a_measured_normal_is_that_of_the_plane_seen() -> None:
    normal = np.array([0.3, -0.4, -1.0])
    normal /= np.linalg.norm(normal)
    v, u = np.mgrid[: at.SIZE[1], : at.SIZE[0]]
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1)
    depth = (normal[2] * 0.5 / (rays @ normal)).astype(np.float32)
    np.testing.assert_allclose(kernels.measured_normal(depth, K, 60, 50, 4), normal, atol=1e-4)
    depth[54, 60] = 0.0
    assert kernels.measured_normal(depth, K, 60, 50, 4) == (0.0, 0.0, 0.0)
    assert kernels.measured_normal(depth, K, 3, 100, 4) == (0.0, 0.0, 0.0)
