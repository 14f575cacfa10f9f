"""Symmetry: what the catalogue declares, and what is detected in a mesh."""

import logging

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from binpick_env.parts import (
    CATALOGUE,
    Part,
    SymmetrySettings,
    detect_symmetry,
    load_part,
    near_symmetry,
    symmetry_error,
)
from binpick_env.parts.surface import SurfaceProbe
from perception.geometry import make_transform, random_rotation, rotation_about, rotation_angle
from perception.part import Symmetry
from tests.binpick_env.parts.part_meshes import ell, naive_distance

seeds = st.integers(0, 2**32 - 1)
creation = trimesh.creation


@pytest.fixture(params=CATALOGUE)
def part(request: pytest.FixtureRequest) -> Part:
    return load_part(request.param)


def undeclared_turns(part: Part) -> list[np.ndarray]:
    principal = np.linalg.eigh(part.inertia)[1].T
    turns = [rotation_about(a, 2 * np.pi / n) for a in (*np.eye(3), *principal) for n in range(2, 13)]
    return [turn for turn in turns if part.model.symmetry.distance(turn, np.eye(3)) > 1e-3]


def test_declared_symmetry_is_true_and_complete(part: Part) -> None:
    probe, tolerance = SurfaceProbe(part.model.mesh), 0.0015 * part.model.d_max
    for element in part.model.symmetry.elements(steps=9):
        assert probe.error(element, part.model.centre) < tolerance
    others = undeclared_turns(part)
    assert len(others) >= 20
    for turn in others:
        assert not probe.fits(turn, part.model.centre, 10 * tolerance)


def test_detection_agrees_with_the_declaration(part: Part) -> None:
    declared, found = part.model.symmetry, detect_symmetry(part.model.mesh)
    assert found.order == declared.order
    assert len(found.rotations) == len(declared.rotations)
    for element in declared.elements(steps=7):
        assert found.distance(element, np.eye(3)) < 1e-3
    for element in found.elements(steps=7):
        assert declared.distance(element, np.eye(3)) < 1e-3


def test_a_wrong_declaration_would_be_noticed() -> None:
    tee, bracket, wheel = (load_part(name).model for name in ("tee", "bracket", "part_a"))
    assert symmetry_error(tee.mesh, rotation_about((1, 0, 0), np.pi), tee.centre) > 0.1 * tee.d_max
    assert symmetry_error(bracket.mesh, rotation_about((1, 0, 1), np.pi), bracket.centre) > 0.02 * bracket.d_max
    assert symmetry_error(wheel.mesh, rotation_about((1, 0, 0), np.pi), wheel.centre) > 0.1 * wheel.d_max


def test_one_small_hole_breaks_a_symmetry() -> None:
    plate = creation.box((0.08, 0.05, 0.006))
    hole = creation.cylinder(radius=0.0025, height=0.02, sections=16)
    hole.apply_translation((0.03, 0.0, 0.0))
    assert detect_symmetry(plate).order == 4
    drilled = trimesh.boolean.difference([plate, hole], engine="manifold")
    found = detect_symmetry(drilled)
    assert found.order == 2  # only the half turn about the line through the hole and the middle is left
    assert found.distance(rotation_about((1, 0, 0), np.pi), np.eye(3)) < 0.02


@pytest.mark.parametrize(
    ("solid", "order", "rotations"),
    [
        (creation.box((0.08, 0.06, 0.04)), 4, 4),
        (creation.box((0.05, 0.05, 0.08)), 8, 8),
        (creation.cylinder(radius=0.03, height=0.05, sections=6), 12, 12),
        (trimesh.convex.convex_hull(0.03 * np.array([[1.0, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]])), 12, 12),
        (creation.cylinder(radius=0.02, height=0.08, sections=64), np.inf, 2),
        (creation.cone(radius=0.03, height=0.06, sections=64), np.inf, 1),
    ],
    ids=["box", "square bar", "hexagon", "tetrahedron", "cylinder", "cone"],
)
def test_detection_finds_the_known_groups_in_any_attitude(solid: trimesh.Trimesh, order: float, rotations: int) -> None:
    mesh = solid.copy()
    mesh.apply_transform(make_transform(random_rotation(np.random.default_rng(5)), (0.01, 0.02, 0.03)))
    found = detect_symmetry(mesh)
    assert found.order == order
    assert len(found.rotations) == rotations
    errors = [symmetry_error(mesh, element, mesh.center_mass) for element in found.elements(steps=5)]
    assert max(errors) < 0.005 * 0.1


def test_the_orientation_of_a_ball_is_free() -> None:
    found = detect_symmetry(creation.icosphere(subdivisions=4, radius=0.03))
    assert found.sphere
    assert found.order == np.inf


def gear(teeth: int, *, hub: bool) -> trimesh.Trimesh:
    """Return a disc with teeth of 8 x 4 x 10 mm, on which a hub may stand: its group has n or 2n elements."""
    solids = [creation.cylinder(radius=0.026, height=0.01, sections=4 * teeth)]
    for k in range(teeth):
        tooth = creation.box((0.008, 0.004, 0.01))
        tooth.apply_translation((0.026, 0, 0))
        tooth.apply_transform(make_transform(rotation_about((0, 0, 1), 2 * np.pi * k / teeth)))
        solids.append(tooth)
    if hub:
        top = creation.cylinder(radius=0.012, height=0.018, sections=4 * teeth)
        top.apply_translation((0, 0, 0.004))
        solids.append(top)
    return trimesh.boolean.union(solids, engine="manifold")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("teeth", "hub", "order"), [(5, True, 5), (8, True, 8), (11, True, 11), (9, False, 18), (24, True, 24)]
)
def test_gears_have_the_group_of_their_teeth(teeth: int, hub: bool, order: int) -> None:
    found = detect_symmetry(gear(teeth, hub=hub)).rotations
    assert len(found) == order
    products = np.einsum("aij,bjk->abik", found, found).reshape(-1, 3, 3)
    assert max(rotation_angle(found @ product.T).min() for product in products) < np.deg2rad(0.5)  # it is a group


def test_a_near_symmetry_is_said_with_its_error(caplog: pytest.LogCaptureFixture) -> None:
    bar = creation.box((0.05, 0.0506, 0.08))
    with caplog.at_level(logging.INFO):
        assert detect_symmetry(bar, SymmetrySettings(metres=0.0002)).order == 4
    assert "no symmetry, but nearly: a turn by 90 deg about" in caplog.text
    assert "deviates by 0.30 mm, the tolerance is 0.20 mm" in caplog.text
    assert "orders above 36 are unsearched" in caplog.text
    assert detect_symmetry(bar, SymmetrySettings(metres=0.0005)).order == 8


def test_orders_beyond_the_search_are_said_to_be_unsearched_where_nothing_is_found(
    caplog: pytest.LogCaptureFixture,
) -> None:
    corner = trimesh.Trimesh(
        [(0, 0, 0), (0.05, 0, 0), (0, 0.03, 0), (0, 0, 0.02)], [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    )
    with caplog.at_level(logging.INFO):
        assert detect_symmetry(corner).order == 1
    assert "no rotation maps the part onto itself; orders above 36 are unsearched" in caplog.text


def test_the_nearest_symmetry_is_found_with_its_angle_and_deviation() -> None:
    nearly = trimesh.creation.box((0.05, 0.049, 0.02))
    found = detect_symmetry(nearly)
    near = near_symmetry(nearly, found)
    assert near is not None
    assert near.angle_deg == 90.0
    np.testing.assert_allclose(np.abs(near.axis), (0, 0, 1), atol=1e-9)
    assert near.deviation == pytest.approx(0.0005, abs=2e-5)  # half the difference of the sides
    assert near.deviation > near.tolerance
    assert near_symmetry(trimesh.creation.box((0.05, 0.03, 0.02)), found) is None


def test_what_turns_freely_has_no_near_symmetry() -> None:
    axis = Symmetry(axis=np.array([0.0, 0.0, 1.0]))
    for group in (axis, Symmetry(sphere=True)):
        assert near_symmetry(trimesh.creation.box((0.05, 0.049, 0.02)), group) is None


def test_a_tolerance_of_the_parts_own_size_is_refused() -> None:
    with pytest.raises(ValueError, match=r"symmetry_tolerance must be under a tenth of d_max, .* got 0\.02 m"):
        detect_symmetry(ell(), SymmetrySettings(metres=0.02))


@settings(deadline=None, max_examples=10)
@given(seeds, st.sampled_from([0.0, 1e-9, 1e-6]))
def test_symmetry_error_of_barely_a_turn_is_barely_anything(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    mesh = ell()
    mesh.apply_transform(make_transform(random_rotation(rng), rng.normal(size=3) * 0.1))
    turn = rotation_about(rng.normal(size=3), angle)
    assert symmetry_error(mesh, turn, mesh.center_mass) <= 0.06 * angle + 1e-12


@settings(deadline=None, max_examples=10)
@given(seeds)
def test_surface_distance_agrees_with_the_naive_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = ell()
    points = mesh.sample(30, seed=int(rng.integers(2**31)))
    points = points + rng.normal(size=points.shape) * rng.choice([0.0, 1e-4, 0.02], size=(len(points), 1))
    found, naive = SurfaceProbe(mesh).distance(points), naive_distance(mesh, points)
    np.testing.assert_allclose(found, naive, atol=1e-12)


def test_symmetry_error_of_a_shifted_centre_by_hand() -> None:
    cube = creation.box((0.04, 0.04, 0.04))
    # A half turn about a line 1 mm beside the middle shifts the cube by 2 mm.
    assert symmetry_error(cube, rotation_about((0, 0, 1), np.pi), np.array([0.001, 0, 0])) == pytest.approx(
        0.002, rel=1e-6
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tolerance": 0.0}, r"tolerance must be in \(0, 0.1\)"),
        ({"metres": 0.0}, r"symmetry_tolerance must be over 0 and under 0.1 m, got 0.0"),
        ({"samples": 10}, "samples must be at least 100, got 10"),
    ],
)
def test_symmetry_settings_reject(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SymmetrySettings(**arguments)  # type: ignore[arg-type]


def test_symmetry_error_rejects_shapes() -> None:
    with pytest.raises(ValueError, match=r"rotation must be \(3, 3\), got \(4, 4\)"):
        symmetry_error(ell(), np.eye(4), np.zeros(3))
    with pytest.raises(ValueError, match=r"centre must be \(3,\), got \(2,\)"):
        symmetry_error(ell(), np.eye(3), np.zeros(2))
