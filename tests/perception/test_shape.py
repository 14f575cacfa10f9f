"""Shape signatures: equal for one shape in any attitude and tessellation, different for shapes that differ a little."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from perception.geometry import make_transform
from perception.part import PartModel
from perception.shape import LARGEST, same_shape, shape_signature, shape_values


def signature(mesh: trimesh.Trimesh) -> tuple[float, ...]:
    return shape_signature(PartModel.from_mesh("part", mesh))


def test_the_invariants_of_a_box_are_those_of_the_formulas() -> None:
    a, b, c = 0.02, 0.03, 0.06
    radii = np.sqrt(np.array([a * a + b * b, a * a + c * c, b * b + c * c]) / 12)
    expected = [np.sqrt(a * a + b * b + c * c), np.sqrt(2 * (a * b + a * c + b * c)), np.cbrt(a * b * c), *radii]
    np.testing.assert_allclose(signature(trimesh.creation.box((a, b, c))), expected, rtol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_attitude_place_order_and_subdivision_change_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = trimesh.creation.annulus(0.01, 0.02, 0.015)
    other = mesh.subdivide()
    other.faces = other.faces[rng.permutation(len(other.faces))]
    other.apply_transform(make_transform(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)))
    assert same_shape(signature(mesh), signature(other))


def test_a_millimetre_is_another_shape_and_numbers_of_another_version_are_none() -> None:
    whole = signature(trimesh.creation.annulus(0.01, 0.02, 0.015))
    assert not same_shape(whole, signature(trimesh.creation.annulus(0.011, 0.02, 0.015)))
    assert not same_shape(whole, whole[:-1])


def test_a_mesh_without_volume_is_refused() -> None:
    mesh = trimesh.creation.box((0.02, 0.02, 0.02))
    mesh.invert()
    part = PartModel(name="lid", mesh=mesh, d_max=0.03, symmetry=None, centre=np.zeros(3))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="the mesh of 'lid' must enclose a volume, got -8e-06"):
        shape_signature(part)


def test_the_values_of_a_shape_do_not_depend_on_its_size() -> None:
    small, large = (signature(trimesh.creation.annulus(s, 2 * s, 1.5 * s)) for s in (0.01, 0.1))
    np.testing.assert_allclose(shape_values(small), shape_values(large), atol=1e-9)


def test_the_values_tell_a_slender_part_from_a_compact_one_and_are_limited() -> None:
    rod, cube, wire = (signature(trimesh.creation.box((0.1, w, w))) for w in (0.01, 0.1, 1e-5))
    assert (shape_values(rod)[:3] < shape_values(cube)[:3] - 1).all()
    assert shape_values(wire).min() == -LARGEST


@pytest.mark.parametrize("bad", [(0.1,) * 5, (0.1,) * 5 + (0.0,), (0.1,) * 5 + (np.nan,)])
def test_what_is_no_signature_has_no_values(bad: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="signature must"):
        shape_values(bad)
