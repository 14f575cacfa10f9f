"""Symmetry groups, their distance between rotations, and the exact diameter."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from perception import part
from perception.geometry import random_rotation, rotation_about, rotation_angle
from perception.part import PartModel, Symmetry, diameter, require_volume

Z = np.array([0.0, 0.0, 1.0])
C2 = Symmetry(rotations=np.stack([np.eye(3), rotation_about(Z, np.pi)]))
C4 = Symmetry(rotations=np.stack([rotation_about(Z, k * np.pi / 2) for k in range(4)]))
ROUND = Symmetry(axis=Z)
ROUND_FLIP = Symmetry(rotations=np.stack([np.eye(3), rotation_about((1, 0, 0), np.pi)]), axis=Z)
GROUPS = (Symmetry(), C2, C4, ROUND, ROUND_FLIP)
groups = st.sampled_from(GROUPS)
seeds = st.integers(0, 2**32 - 1)
# Turns from none over barely any to half a turn.
angles = st.one_of(st.sampled_from([0.0, 1e-12, 1e-8, 1e-4, np.pi]), st.floats(0.0, np.pi))


def naive_distance(symmetry: Symmetry, rotation_a: np.ndarray, rotation_b: np.ndarray, steps: int = 720) -> float:
    return min(float(rotation_angle(rotation_a @ g @ rotation_b.T)) for g in symmetry.elements(steps))


@settings(deadline=None, max_examples=60)
@given(groups, seeds)
def test_distance_of_a_rotation_to_itself_is_zero(symmetry: Symmetry, seed: int) -> None:
    rotation = random_rotation(np.random.default_rng(seed))
    assert symmetry.distance(rotation, rotation) == pytest.approx(0.0, abs=1e-12)
    assert symmetry.distance(np.eye(3), np.eye(3)) == 0.0


@pytest.mark.slow
@settings(deadline=None, max_examples=60)
@given(groups, seeds, seeds)
def test_distance_agrees_with_the_naive_twin(symmetry: Symmetry, seed_a: int, seed_b: int) -> None:
    a, b = (random_rotation(np.random.default_rng(seed)) for seed in (seed_a, seed_b))
    step = 0.0 if symmetry.axis is None else np.pi / 720  # the twin samples the axis and can miss by half a step
    assert symmetry.distance(a, b) <= naive_distance(symmetry, a, b) + 1e-9
    assert symmetry.distance(a, b) >= naive_distance(symmetry, a, b) - step - 1e-9


@settings(deadline=None, max_examples=60)
@given(groups, seeds, seeds)
def test_distance_is_symmetric_and_ignores_group_elements_and_the_world(
    symmetry: Symmetry, seed: int, other: int
) -> None:
    rng = np.random.default_rng([seed, other])
    a, b, world = (random_rotation(rng) for _ in range(3))
    element = symmetry.elements()[rng.integers(len(symmetry.elements()))]
    expected = pytest.approx(symmetry.distance(a, b), abs=1e-7)
    assert symmetry.distance(b, a) == expected
    assert symmetry.distance(a @ element, b) == expected
    assert symmetry.distance(world @ a, world @ b) == expected
    assert symmetry.distance(a @ element, a) == pytest.approx(0.0, abs=1e-7)


@settings(deadline=None, max_examples=60)
@given(angles, seeds)
def test_trivial_distance_is_the_angle_also_near_identity(angle: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = random_rotation(rng)
    b = a @ rotation_about(rng.normal(size=3), angle)
    assert Symmetry().distance(a, b) == pytest.approx(angle, abs=1e-12, rel=1e-6)


@settings(deadline=None, max_examples=60)
@given(angles, angles, seeds)
def test_round_distance_is_the_tilt_of_the_axis(tilt: float, spin: float, seed: int) -> None:
    a = random_rotation(np.random.default_rng(seed))
    b = a @ rotation_about(Z, spin) @ rotation_about((1, 0, 0), tilt) @ rotation_about(Z, -2 * spin)
    assert ROUND.distance(a, b) == pytest.approx(tilt, abs=1e-12, rel=1e-6)
    assert ROUND_FLIP.distance(a, b) == pytest.approx(min(tilt, np.pi - tilt), abs=1e-12, rel=1e-6)


def test_every_rotation_of_a_ball_is_the_same() -> None:
    ball = Symmetry(sphere=True)
    assert ball.order == np.inf
    assert ball.distance(rotation_about((1, 2, 3), 2.0), np.eye(3)) == 0.0
    elements = ball.elements(steps=200)
    np.testing.assert_array_equal(elements[0], np.eye(3))
    np.testing.assert_allclose(elements @ np.swapaxes(elements, 1, 2), np.tile(np.eye(3), (200, 1, 1)), atol=1e-12)
    apart = [np.sort(rotation_angle(elements @ element.T))[1] for element in elements]
    assert min(apart) > np.deg2rad(15)  # evenly spread: 200 rotations lie some 30 deg apart


def test_discrete_distance_by_hand() -> None:
    third = rotation_about(Z, np.deg2rad(120))
    assert np.rad2deg(Symmetry().distance(third, np.eye(3))) == pytest.approx(120)
    assert np.rad2deg(C2.distance(third, np.eye(3))) == pytest.approx(60)
    assert np.rad2deg(C4.distance(third, np.eye(3))) == pytest.approx(30)
    assert ROUND.distance(third, np.eye(3)) == pytest.approx(0.0, abs=1e-12)
    over = rotation_about((1, 0, 0), np.pi)  # ends swapped: no rotation about z undoes it
    assert C4.distance(over, np.eye(3)) == pytest.approx(np.pi)
    assert ROUND.distance(over, np.eye(3)) == pytest.approx(np.pi)
    assert ROUND_FLIP.distance(over, np.eye(3)) == pytest.approx(0.0, abs=1e-12)


def test_order_and_elements() -> None:
    assert [group.order for group in GROUPS] == [1, 2, 4, np.inf, np.inf]
    assert [len(group.elements(steps=36)) for group in GROUPS] == [1, 2, 4, 36, 72]
    for group in GROUPS:
        elements = group.elements(steps=12)
        np.testing.assert_allclose(elements[0], np.eye(3), atol=1e-15)
        np.testing.assert_allclose(
            elements @ np.swapaxes(elements, 1, 2), np.tile(np.eye(3), (len(elements), 1, 1)), atol=1e-12
        )
        products = np.einsum("aij,bjk->abik", elements, elements).reshape(-1, 3, 3)
        gaps = [rotation_angle(elements @ product.T).min() for product in products]
        assert max(gaps) < 1e-7  # closed under multiplication


def test_a_symmetry_may_be_given_as_lists() -> None:
    symmetry = Symmetry(rotations=[np.eye(3).tolist()], axis=(0, 0, 1))  # type: ignore[arg-type]
    assert symmetry.order == np.inf
    assert symmetry.distance(np.eye(3), rotation_about((0, 0, 1), 1.0)) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rotations": np.eye(3)}, r"rotations must be \(N, 3, 3\), got \(3, 3\)"),
        ({"rotations": np.zeros((0, 3, 3))}, "must begin with the identity"),
        ({"rotations": rotation_about(Z, 1.0)[None]}, "must begin with the identity"),
        ({"rotations": np.stack([np.eye(3), np.diag([1.0, 1.0, -1.0])])}, "must be proper rotation matrices"),
        ({"rotations": np.stack([np.eye(3), 2 * np.eye(3)])}, "must be proper rotation matrices"),
        ({"axis": Z, "sphere": True}, "a ball's symmetry contains every rotation: name neither an axis nor rotations"),
        ({"axis": np.array([0.0, 1.0])}, r"axis must be \(3,\), got \(2,\)"),
        ({"axis": np.array([0.0, 0.0, 2.0])}, r"axis must be a unit vector, got \[0.0, 0.0, 2.0\]"),
    ],
)
def test_symmetry_rejects(arguments: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Symmetry(**arguments)


@settings(deadline=None, max_examples=30)
@given(seeds, st.integers(4, 300))
def test_diameter_agrees_with_the_naive_twin(seed: int, count: int) -> None:
    points = np.random.default_rng(seed).normal(size=(count, 3)) * (1.0, 0.5, 0.1)
    naive = np.linalg.norm(points[:, None] - points[None], axis=-1).max()
    assert diameter(points) == pytest.approx(naive, rel=1e-12)


def test_diameter_of_a_hull_of_many_points(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(part, "_MOST_PAIRS", 1000)
    sphere = trimesh.creation.uv_sphere(radius=0.04, count=(36, 36)).vertices
    points = np.concatenate([sphere, [[0.0401, 0.0, 0.0], [-0.0401, 0.0, 0.0]]])  # farthest apart, in the last block
    assert len(ConvexHull(points).vertices) > 1100
    assert diameter(points) == pytest.approx(0.0802, abs=1e-9)
    assert len(part._far_points(points)) == 2  # the rest is too near to their middle
    points = np.concatenate([sphere, [[0.04000001, 0.0, 0.0]]])  # hardly farther: all points remain, in blocks
    assert len(part._far_points(points)) > 1100
    assert diameter(points) == pytest.approx(pdist(points).max(), rel=1e-12)


def test_diameter_of_a_box_is_its_diagonal() -> None:
    assert diameter(trimesh.creation.box((0.03, 0.04, 0.12)).vertices) == pytest.approx(0.13)


def test_model_measures_the_mesh() -> None:
    mesh = trimesh.creation.box((0.03, 0.04, 0.12))
    mesh.apply_translation((1.0, 2.0, 3.0))
    model = PartModel.from_mesh("box", mesh)
    assert model.name == "box"
    assert model.d_max == pytest.approx(0.13)
    np.testing.assert_allclose(model.centre, (1.0, 2.0, 3.0))
    assert model.symmetry.order == 1
    assert PartModel.from_mesh("box", mesh, C2).symmetry is C2


def test_model_rejects_an_open_mesh() -> None:
    mesh = trimesh.creation.box((0.03, 0.04, 0.12))
    mesh.update_faces(np.arange(11))
    with pytest.raises(ValueError, match="the mesh of 'lid' must be watertight"):
        PartModel.from_mesh("lid", mesh)


def test_model_rejects_what_is_no_mesh() -> None:
    with pytest.raises(ValueError, match=r"mesh must be a Trimesh, got 'lid\.stl': .*load_part reads files"):
        PartModel.from_mesh("lid", "lid.stl")  # type: ignore[arg-type]


def test_model_turns_inverted_faces_in_a_copy() -> None:
    mesh = trimesh.creation.box((0.03, 0.04, 0.12))
    mesh.invert()
    model = PartModel.from_mesh("box", mesh)
    assert mesh.volume < 0
    assert model.mesh.volume == pytest.approx(0.03 * 0.04 * 0.12)
    np.testing.assert_allclose(model.centre, 0.0, atol=1e-12)


def boxes(*scales: float) -> trimesh.Trimesh:
    """Return boxes about the origin, one in the other; a negative scale turns normals inwards."""
    shells = []
    for scale in scales:
        shell = trimesh.creation.box(np.array([0.06, 0.04, 0.04]) * abs(scale))
        if scale < 0:
            shell.invert()
        shells.append(shell)
    mesh = trimesh.util.concatenate(shells)
    mesh.apply_translation((0.1, 0.0, 0.0))
    return mesh


@pytest.mark.parametrize(
    ("scales", "share"), [((1, -0.6), 1 - 0.6**3), ((-1, 0.6), 1 - 0.6**3), ((1, 0.6), 1 + 0.6**3)]
)
def test_a_shell_inside_another_keeps_its_winding_relative_to_it(scales: tuple[float, float], share: float) -> None:
    model = PartModel.from_mesh("box", boxes(*scales))
    assert model.mesh.volume == pytest.approx(0.06 * 0.04 * 0.04 * share)
    np.testing.assert_allclose(model.centre, (0.1, 0.0, 0.0), atol=1e-9)


def test_a_shell_beside_another_is_turned_outwards() -> None:
    inverted = trimesh.creation.box((0.03, 0.03, 0.03))
    inverted.apply_translation((0.05, 0.0, 0.0))
    inverted.invert()
    mesh = trimesh.util.concatenate([trimesh.creation.box((0.03, 0.03, 0.03)), inverted])
    assert PartModel.from_mesh("two", mesh).mesh.volume == pytest.approx(2 * 0.03**3)


def test_model_rejects_a_sheet_of_two_sides() -> None:
    sheet = trimesh.Trimesh([(0, 0, 0), (0.05, 0, 0), (0.05, 0.05, 0), (0, 0.05, 0.01)], [(0, 1, 2), (0, 2, 1)])
    with pytest.raises(ValueError, match=r"the mesh of 'foil' must enclose a volume, got .* a sheet needs a thickness"):
        PartModel.from_mesh("foil", sheet)


def test_model_rejects_vertices_that_are_not_finite() -> None:
    mesh = trimesh.creation.box((0.03, 0.04, 0.12))
    mesh.vertices[0] = np.nan
    with pytest.raises(ValueError, match="the mesh of 'box' must have faces and finite vertices"):
        PartModel.from_mesh("box", mesh)


def test_model_rejects_surfaces_that_leave_the_centre_outside() -> None:
    near, far = trimesh.creation.box((0.03, 0.03, 0.03)), trimesh.creation.box((0.0295, 0.0295, 0.0295))
    far.apply_translation((0.0302, 0.0, 0.0))
    far.invert()
    mesh = trimesh.util.concatenate([near, far])
    with pytest.raises(ValueError, match="the centre of 'two' must lie within its bounds"):
        require_volume("two", mesh)  # as it is; from_mesh turns the second box


@pytest.mark.parametrize(
    ("side", "message"),
    [
        (50.0, r"0\.003 to 1 m, got 86\.6 m: the mesh is probably in mm \(0\.0866 m\)"),
        (10.0 / np.sqrt(3), r"got 10 m: the mesh is probably in mm \(0\.01 m\) or cm \(0\.1 m\)"),
        (5e-5, r"got 8\.66e-05 m: a mesh in metres was probably read as mm \(0\.0866 m\)"),
        (1e-9, r"got 1\.73e-09 m: the mesh must be in metres"),
    ],
)
def test_model_rejects_sizes_that_are_no_parts_and_names_the_unit(side: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PartModel.from_mesh("box", trimesh.creation.box((side, side, side)))


@pytest.mark.parametrize("side", [0.003, 0.5])
def test_model_takes_small_and_large_parts(side: float) -> None:
    assert PartModel.from_mesh("box", trimesh.creation.box((side, side, side))).d_max == pytest.approx(side * 3**0.5)
