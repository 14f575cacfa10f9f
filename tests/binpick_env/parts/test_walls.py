"""The thickness of walls, measured from inside the surface to the opposite one."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from binpick_env.parts import CATALOGUE, load_part
from binpick_env.parts.families import FAMILIES
from binpick_env.parts.mesh_file import LEAST_THICKNESS, THIN_WALLS, read_mesh
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


def stored(mesh: trimesh.Trimesh, folder: Path) -> Path:
    path = folder / "part.stl"
    mesh.export(path)
    return path


def bent(thickness: float) -> trimesh.Trimesh:
    """Return an L of two sheets."""
    foot, wall = trimesh.creation.box((0.06, 0.04, thickness)), trimesh.creation.box((thickness, 0.04, 0.03))
    wall.apply_translation((0.03 - thickness / 2, 0, 0.015 - thickness / 2))
    return trimesh.boolean.union([foot, wall], engine="manifold")


def tray(thickness: float) -> trimesh.Trimesh:
    """Return an open box with walls of one thickness."""
    inside = trimesh.creation.box((0.06 - 2 * thickness, 0.04 - 2 * thickness, 0.02))
    inside.apply_translation((0, 0, thickness))
    return trimesh.boolean.difference([trimesh.creation.box((0.06, 0.04, 0.02)), inside], engine="manifold")


def finned(thickness: float) -> trimesh.Trimesh:
    """Return a block with a fin."""
    fin = trimesh.creation.box((0.02, thickness, 0.02))
    fin.apply_translation((0, 0, 0.02))
    return trimesh.boolean.union([trimesh.creation.box((0.06, 0.04, 0.02)), fin], engine="manifold")


@pytest.mark.parametrize("make", [bent, tray])
def test_thin_walls_are_refused_though_the_box_around_them_is_thick(
    tmp_path: Path, make: Callable[[float], trimesh.Trimesh], caplog: pytest.LogCaptureFixture
) -> None:
    text = r"has walls of about 0\.05 mm on (99|100) % of its surface, taken as m; the cell simulates walls from"
    with pytest.raises(ValueError, match=text + r" 0\.2 mm on: thicken the walls, or name another unit"):
        read_mesh(stored(make(0.00005), tmp_path))
    assert read_mesh(stored(make(0.0002), tmp_path)).volume == pytest.approx(make(0.0002).volume, rel=1e-3)
    assert not caplog.records


def test_a_thin_fin_is_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    read_mesh(stored(finned(0.0003), tmp_path))
    assert not caplog.records
    read_mesh(stored(finned(0.0001), tmp_path))
    text = r"has walls of about 0\.1 mm on (8|9|10|11|12) % of its surface, taken as m; contacts of walls under 0\.2 mm"
    assert re.search(text, caplog.text)


def test_a_sharp_edge_is_no_thin_wall(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    read_mesh(stored(trimesh.creation.cone(radius=0.02, height=0.03, sections=64), tmp_path))
    wedge = trimesh.convex.convex_hull(
        np.vstack([trimesh.creation.box((0.06, 0.04, 0.0)).vertices, [[-0.03, 0, 0.02]]])
    )
    read_mesh(stored(wedge, tmp_path))
    assert not caplog.records
