"""Surfaces that touch along an edge, in a vertex or in a face, as bodies in one file do."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from binpick_env.parts.mesh_bodies import bodies_of
from binpick_env.parts.mesh_edges import separated
from binpick_env.parts.mesh_file import read_mesh
from perception.geometry import make_transform, random_rotation
from perception.winding import shells_of
from tests.binpick_env.parts.part_meshes import ell
from tests.binpick_env.parts.step_files import step_text

creation = trimesh.creation


def cube(x: float, y: float = 0.0, z: float = 0.0) -> trimesh.Trimesh:
    mesh = creation.box((0.02, 0.02, 0.02))
    mesh.apply_translation((x, y, z))
    return mesh


def fine(mesh: trimesh.Trimesh, times: int) -> trimesh.Trimesh:
    for _ in range(times):
        mesh = mesh.subdivide()
    return mesh


def rod(sections: int, z: float) -> trimesh.Trimesh:
    return creation.cylinder(
        0.01, 0.02, sections=sections, transform=trimesh.transformations.translation_matrix((0, 0, z))
    )


FLUSH = {  # bodies, and the area of their union where it is known [m^2]
    "same faces": ([cube(0), cube(0.02), cube(0.04)], 14 * 0.02**2),
    "finer faces": ([fine(cube(0), 1), fine(cube(0.02), 2)], 10 * 0.02**2),
    "partly the same faces": ([cube(0).subdivide_to_size(0.013), fine(cube(0.02), 2)], 10 * 0.02**2),
    "common vertices": ([rod(32, 0), rod(45, 0.02)], None),
    "around an edge": ([cube(x, y) for x in (0, 0.02) for y in (0, 0.02)], 16 * 0.02**2),
}


@pytest.mark.slow
@pytest.mark.parametrize("winding", ["outwards", "inwards"])
@pytest.mark.parametrize("turn", ["straight", "turned"])
@pytest.mark.parametrize(("bodies", "area"), FLUSH.values(), ids=FLUSH)
def test_flush_bodies_are_united_however_they_are_triangulated(
    tmp_path: Path, bodies: list[trimesh.Trimesh], area: float | None, turn: str, winding: str
) -> None:
    whole = trimesh.util.concatenate(bodies)
    if turn == "turned":
        whole.apply_transform(make_transform(random_rotation(np.random.default_rng(1)), (0.01, 0.02, 0.03)))
    if winding == "inwards":
        whole.invert()
    whole.export(tmp_path / "part.stl")
    mesh = read_mesh(tmp_path / "part.stl", "m")
    assert mesh.is_volume
    assert len(shells_of(mesh)) == len(bodies_of(mesh)) == 1
    assert mesh.volume == pytest.approx(sum(body.volume for body in bodies), rel=2e-5)
    assert area is None or mesh.area == pytest.approx(area, rel=2e-5)


@pytest.mark.slow
def test_a_step_assembly_of_flush_solids_is_united(tmp_path: Path) -> None:
    lower, upper = creation.box((20, 20, 20)), creation.box((20, 20, 20))
    upper.apply_translation((0, 0, 20))
    (tmp_path / "part.step").write_text(step_text([lower, upper]))
    assert read_mesh(tmp_path / "part.step").volume == pytest.approx(0.02 * 0.02 * 0.04, rel=1e-5)


@pytest.mark.parametrize(
    ("shift", "shells"),
    [((0.02, 0.02, 0.0), 2), ((0.02, 0.02, 0.02), 2), ((0.05, 0, 0), 2)],
    ids=["edge", "vertex", "apart"],
)
def test_separated_surfaces_share_no_vertex(shift: tuple[float, float, float], shells: int) -> None:
    mesh = trimesh.util.concatenate([cube(0), cube(*shift)])
    mesh.merge_vertices()
    found = separated(mesh)
    assert found.is_watertight
    assert len(shells_of(found)) == 2
    assert len(found.vertices) == 16
    np.testing.assert_allclose(found.triangles, mesh.triangles)


def test_a_closed_surface_stays_as_it_is() -> None:
    mesh = ell()
    found = separated(mesh)
    assert len(found.vertices) == len(mesh.vertices)
    np.testing.assert_array_equal(found.triangles, mesh.triangles)


def test_an_open_surface_stays_open() -> None:
    mesh = cube(0)
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    assert not separated(mesh).is_watertight


def test_a_surface_that_touches_itself_along_an_edge_is_one_body(tmp_path: Path) -> None:
    ring = [cube(x, y) for x in (0, 0.02, 0.04) for y in (0, 0.02, 0.04) if (x, y) not in ((0, 0), (0.02, 0.02))]
    whole = trimesh.boolean.union(ring, engine="manifold")
    whole.merge_vertices()
    whole.export(tmp_path / "part.stl")
    assert read_mesh(tmp_path / "part.stl", "m").volume == pytest.approx(7 * 0.02**3, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["stl", "obj"])
@pytest.mark.parametrize(
    "shift",
    [(0.02, 0.02, 0), (0.02, 0.02, 0.007), (0.02, 0.02, 0.02), (0.013, 0.02, 0.02)],
    ids=["edge", "part of an edge", "vertex", "part of another edge"],
)
def test_bodies_that_touch_along_an_edge_or_in_a_point_are_apart(
    tmp_path: Path, shift: tuple[float, float, float], suffix: str
) -> None:
    path = tmp_path / f"part.{suffix}"
    trimesh.util.concatenate([cube(0), cube(*shift)]).export(path)
    with pytest.raises(ValueError, match="holds 2 bodies, of which 2 remain apart: they touch only along an edge"):
        read_mesh(path, "m")


def test_bodies_that_touch_along_an_edge_and_are_joined_by_a_third_are_one(tmp_path: Path) -> None:
    trimesh.util.concatenate([cube(0), cube(0.02, 0.02), cube(0.02)]).export(tmp_path / "part.stl")
    assert read_mesh(tmp_path / "part.stl", "m").volume == pytest.approx(3 * 0.02**3, rel=1e-4)


def test_one_body_that_hangs_on_by_an_edge_is_counted(tmp_path: Path) -> None:
    trimesh.util.concatenate([cube(0), cube(0.02), cube(0.04, 0.02)]).export(tmp_path / "part.stl")
    with pytest.raises(ValueError, match="holds 3 bodies, of which 2 remain apart"):
        read_mesh(tmp_path / "part.stl", "m")


def test_a_small_common_face_holds_bodies_together(tmp_path: Path) -> None:
    trimesh.util.concatenate([cube(0), cube(0.02, 0.0199, 0.0199)]).export(tmp_path / "part.stl")
    assert read_mesh(tmp_path / "part.stl", "m").volume == pytest.approx(2 * 0.02**3, rel=1e-4)


def test_a_mesh_whose_faces_are_all_there_twice_is_read_once(tmp_path: Path) -> None:
    mesh = ell()
    trimesh.util.concatenate([mesh, trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1])]).export(tmp_path / "part.stl")
    assert read_mesh(tmp_path / "part.stl").volume == pytest.approx(mesh.volume, rel=1e-5)
