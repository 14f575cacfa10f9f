"""The thickness of walls, measured from inside the surface to the opposite one."""

import numpy as np
import pytest
import trimesh

from binpick_env.parts import CATALOGUE, load_part
from binpick_env.parts.families import FAMILIES
from binpick_env.parts.mesh_file import LEAST_THICKNESS, THIN_WALLS
from binpick_env.parts.part import generate_part
from binpick_env.parts.walls import wall_thickness
from perception.geometry import make_transform, random_rotation


def test_a_box_is_as_thick_as_its_sides_wherever_it_is() -> None:
    rng = np.random.default_rng(0)
    for place in (np.zeros(3), np.array([3.0, -5.0, 1.0])):
        box = trimesh.creation.box((0.06, 0.04, 0.0001), make_transform(random_rotation(rng), place))
        thickness = wall_thickness(box, samples=500)
        assert np.mean(np.isclose(thickness, 0.0001, rtol=1e-3)) > 0.98  # all but those on its rim
        assert thickness.shape == (500,)


def test_a_sphere_is_as_thick_as_its_diameter() -> None:
    thickness = wall_thickness(trimesh.creation.icosphere(subdivisions=4, radius=0.02))
    facing = np.isfinite(thickness)
    assert facing.mean() > 0.5
    assert thickness[facing] == pytest.approx(0.04, rel=0.02)


def test_nothing_faces_the_sides_of_a_cone() -> None:
    assert np.isinf(wall_thickness(trimesh.creation.cone(radius=0.02, height=0.04, sections=64))).all()


@pytest.mark.parametrize("name", CATALOGUE)
def test_the_walls_of_the_catalogue_are_thick_enough(name: str) -> None:
    assert wall_thickness(load_part(name).model.mesh).min() > 5 * LEAST_THICKNESS


@pytest.mark.parametrize("family", FAMILIES)
def test_the_walls_of_generated_parts_are_thick_enough(family: str) -> None:
    """A bore just below a surface leaves a thin wall, which is no reason for a warning."""
    assert np.mean(wall_thickness(generate_part(family, 0).model.mesh) < LEAST_THICKNESS) <= THIN_WALLS[0] / 2
