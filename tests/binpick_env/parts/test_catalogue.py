"""The catalogue: clean solids of a graspable size, their inertia and their convex pieces."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from binpick_env.parts import CATALOGUE, Part, load_part
from tests.binpick_env.parts.part_meshes import naive_distance

creation = trimesh.creation


@pytest.fixture(params=CATALOGUE)
def part(request: pytest.FixtureRequest) -> Part:
    return load_part(request.param)


def test_catalogue_part_is_a_clean_solid_of_a_graspable_size(part: Part) -> None:
    mesh = part.model.mesh
    assert mesh.is_watertight
    assert mesh.is_volume
    assert mesh.body_count == 1
    assert len(mesh.faces) <= 3000
    altitudes = (
        2 * mesh.area_faces / np.linalg.norm(mesh.triangles - np.roll(mesh.triangles, 1, axis=1), axis=2).max(axis=1)
    )
    assert altitudes.min() > 1e-7  # no degenerate face
    assert 0.060 <= part.model.d_max <= 0.100
    assert mesh.extents.min() < 0.075
    assert 0.03 <= part.mass <= 0.35


def test_catalogue_frame_and_inertia(part: Part) -> None:
    np.testing.assert_allclose(part.model.centre, 0.0, atol=1e-9)
    assert part.mass == pytest.approx(part.model.mesh.volume * part.density)
    np.testing.assert_allclose(part.inertia, part.inertia.T, rtol=1e-9)
    low, middle, high = np.linalg.eigvalsh(part.inertia)
    assert 0 < low <= middle <= high < low + middle  # a real body's moments obey the triangle inequality
    assert high < part.mass * part.model.d_max**2 / 4
    assert part.source == part.model.name


def test_inertia_of_a_box_by_hand(tmp_path: Path, cache: Path) -> None:
    creation.box((0.03, 0.04, 0.06)).export(tmp_path / "box.stl")
    box = load_part(tmp_path / "box.stl", density=1000.0)
    assert box.mass == pytest.approx(0.072)
    expected = 0.072 / 12 * np.diag([0.04**2 + 0.06**2, 0.03**2 + 0.06**2, 0.03**2 + 0.04**2])
    np.testing.assert_allclose(box.inertia, expected, rtol=1e-5, atol=1e-12)


def test_pieces_are_few_convex_and_lie_on_the_outside(part: Part) -> None:
    assert 2 <= len(part.pieces) <= 8
    for piece in part.pieces:
        assert piece.is_watertight
        assert piece.volume == pytest.approx(piece.convex_hull.volume, rel=1e-9)
        assert len(piece.vertices) <= 64
    # Nowhere does a piece stand out of the mesh, and on the mesh's hull, where fingers close, both surfaces agree.
    hull = part.model.mesh.convex_hull
    assert trimesh.boolean.union([*part.pieces, hull], engine="manifold").volume == pytest.approx(hull.volume, rel=1e-6)
    outer = part.model.mesh.vertices[naive_distance(hull, part.model.mesh.vertices) < 1e-9]
    solid = trimesh.boolean.union(list(part.pieces), engine="manifold")
    assert naive_distance(solid, outer[::5]).max() < 3e-4


@pytest.mark.parametrize(("name", "bores"), [("part_a", 0.06), ("part_b", 0.01), ("part_c", 0.07), ("bracket", 0.06)])
def test_pieces_exceed_the_mesh_by_its_bores_only(name: str, bores: float) -> None:
    part = load_part(name)
    covered = trimesh.boolean.union(list(part.pieces), engine="manifold").volume
    assert 0.0 < covered / part.model.mesh.volume - 1 < bores


def test_tee_pieces_fill_its_bore_only() -> None:
    part = load_part("tee")
    solid = trimesh.boolean.union(list(part.pieces), engine="manifold")
    # The bores: 85 mm along the run and from its axis to the branch's mouth, where they meet counted once, roughly.
    bore = np.pi * 0.010**2 * (0.085 + 0.050 - 0.010)
    assert solid.volume - part.model.mesh.volume == pytest.approx(bore, rel=0.06)


def test_catalogue_parts_are_built_once_and_cannot_be_changed() -> None:
    assert load_part("tee") is load_part("tee")
    assert load_part("tee", density=1000.0).mass == pytest.approx(load_part("tee").mass * 1000 / 1400)
    with pytest.raises(ValueError, match="immutable"):
        load_part("tee").model.mesh.vertices = np.zeros((3, 3))
    assert load_part("tee").model.mesh.copy().apply_scale(2.0).volume == pytest.approx(
        8 * load_part("tee").model.mesh.volume
    )


def test_importing_parts_imports_neither_torch_nor_coacd() -> None:
    code = "import sys, binpick_env.parts; sys.exit('torch' in sys.modules or 'coacd' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, env=os.environ.copy()).returncode == 0
