"""Every format of parts, several bodies in a file, dirty meshes, and what is not what it seems."""

import logging
import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from binpick_env.parts import load_part
from binpick_env.parts.mesh_bodies import bodies_of
from binpick_env.parts.mesh_file import read_mesh
from tests.binpick_env.parts.part_meshes import ell
from tests.binpick_env.parts.step_files import step_text

creation = trimesh.creation
Save = Callable[..., Path]


@pytest.fixture
def save(tmp_path: Path) -> Save:
    def save_mesh(mesh: trimesh.Trimesh, name: str = "part.stl") -> Path:
        mesh.export(tmp_path / name)
        return tmp_path / name

    return save_mesh


def at(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    return trimesh.transformations.translation_matrix((x, y, z))


def text(path: Path, content: str) -> Path:
    path.write_text(content)
    return path


def three_mf(path: Path, mesh: trimesh.Trimesh, unit: str) -> Path:
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in mesh.vertices)
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces)
    model = (
        f'<model unit="{unit}" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>'
        f'<object id="1" type="model"><mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh>'
        '</object></resources><build><item objectid="1"/></build></model>'
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("3D/3dmodel.model", model)
    return path


# --- formats ---


@pytest.mark.parametrize("suffix", [".off", ".glb", ".OFF"])
def test_other_mesh_formats(save: Save, suffix: str) -> None:
    mesh = read_mesh(save(ell(), f"part{suffix}"))
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(ell().volume, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "scale"), [("mm", 1000.0), ("inch", 1 / 0.0254), ("m", 1.0)])
def test_a_step_file_is_one_body_in_metres(tmp_path: Path, unit: str, scale: float) -> None:
    box = creation.box(np.array([0.03, 0.04, 0.05]) * scale)
    mesh = read_mesh(text(tmp_path / "box.stp", step_text([box], unit)))
    assert mesh.volume == pytest.approx(0.03 * 0.04 * 0.05, rel=1e-5)
    assert len(bodies_of(mesh)) == 1
    assert mesh.metadata["unit"] == "m"


@pytest.mark.slow
def test_a_step_file_of_several_solids(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    pin, head = creation.box((10, 10, 60)), creation.box((30, 40, 20))
    with caplog.at_level(logging.INFO):
        mesh = read_mesh(text(tmp_path / "pin.step", step_text([pin, head])))
    assert mesh.volume == pytest.approx((10 * 10 * 40 + 30 * 40 * 20) * 1e-9, rel=1e-5)
    assert "holds 2 bodies that overlap or touch: they were united" in caplog.text
    far = creation.box((10, 10, 10), at(60))
    with pytest.raises(ValueError, match=r"apart\.step holds 2 bodies, of which 2 remain apart.* one body per file"):
        read_mesh(text(tmp_path / "apart.step", step_text([pin, far])))


@pytest.mark.parametrize(("unit", "metres"), [("inch", 0.0254), ("millimeter", 0.001), ("micron", 1e-6)])
def test_3mf_names_its_unit(tmp_path: Path, unit: str, metres: float) -> None:
    box = creation.box(np.array([0.03, 0.04, 0.05]) / metres)
    mesh = read_mesh(three_mf(tmp_path / "box.3mf", box, unit))
    assert mesh.volume == pytest.approx(0.03 * 0.04 * 0.05, rel=1e-4)
    with pytest.raises(ValueError, match=r"box\.3mf names its own unit: leave out --unit"):
        read_mesh(tmp_path / "box.3mf", unit="mm")


def test_3mf_of_an_unknown_unit(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"its unit must be one of micron, .* got 'furlong'"):
        read_mesh(three_mf(tmp_path / "box.3mf", creation.box((1, 1, 1)), "furlong"))


def test_names_may_hold_dots_and_spaces(save: Save, cache: Path) -> None:
    part = load_part(save(ell(), "my angle v1.2 (new).STL"), symmetry="none")
    assert part.model.name == "my angle v1.2 (new)"


# --- content ---


@pytest.mark.parametrize("name", ["part.ply", "part.off", "part.glb"])
def test_a_file_that_is_not_what_its_name_says(save: Save, name: str) -> None:
    path = save(ell(), name)
    renamed = path.rename(path.with_suffix(".stl"))
    with pytest.raises(ValueError, match=rf"is not what its name says: its content is that of a {path.suffix}"):
        read_mesh(renamed)


@pytest.mark.slow
def test_a_step_file_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"is no STEP file: it must begin with ISO-10303-21, got b'solid"):
        read_mesh(text(tmp_path / "a.step", "solid part"))
    with pytest.raises(ValueError, match="the tessellation failed: OpenCASCADE cannot read it"):
        read_mesh(text(tmp_path / "b.step", "ISO-10303-21;\nnothing"))


def test_a_truncated_binary_stl_is_named_as_such(save: Save) -> None:
    path = save(ell())
    data = path.read_bytes()
    count = struct.unpack("<I", data[80:84])[0]
    path.write_bytes(data[:-70])
    expected = rf"it is truncated: its header announces {count} triangles, which take {len(data)} bytes, and it has"
    with pytest.raises(ValueError, match=expected):
        read_mesh(path)


def test_a_truncated_text_stl_is_named_as_such(tmp_path: Path) -> None:
    content = str(ell().export(file_type="stl_ascii"))
    within = content[: content.rindex("vertex")]
    with pytest.raises(ValueError, match=r"truncated: 26 facets begin, 25 end and endsolid is missing; export"):
        read_mesh(text(tmp_path / "part.stl", within))
    between = content[: content.rindex("endfacet")] + "endfacet\n"
    with pytest.raises(ValueError, match=r"truncated: 26 facets begin, 26 end and endsolid is missing; export"):
        read_mesh(text(tmp_path / "part.stl", between))
    hole = content.replace("endfacet", "", 1)
    with pytest.raises(ValueError, match=r"truncated: 26 facets begin, 25 end; export or copy it again"):
        read_mesh(text(tmp_path / "part.stl", hole))


def test_bytes_after_a_binary_stl_are_ignored(save: Save) -> None:
    path = save(ell())
    path.write_bytes(path.read_bytes() + b"exported by nobody" * 3)
    assert read_mesh(path).volume == pytest.approx(ell().volume, rel=1e-5)


@pytest.mark.parametrize("name", ["part.obj", "part.stl", "part.ply", "text.ply", "part.off"])
def test_comments_in_latin_1_are_read(tmp_path: Path, name: str) -> None:
    latin = "Gehäuse".encode("latin-1")
    if name.endswith("obj"):
        content = b"# " + latin + b"\n" + str(ell().export(file_type="obj")).encode()
    elif name.endswith("off"):
        content = str(ell().export(file_type="off")).encode().replace(b"OFF\n", b"OFF\n# " + latin + b"\n", 1)
    elif name.endswith("ply"):
        encoding = "ascii" if name == "text.ply" else "binary"
        data = ell().export(file_type="ply", encoding=encoding)
        content = data.replace(b"ply\n", b"ply\ncomment " + latin + b"\n", 1)
    else:
        content = str(ell().export(file_type="stl_ascii")).encode().replace(b"solid", b"solid " + latin, 1)
    (tmp_path / name).write_bytes(content)
    assert read_mesh(tmp_path / name).volume == pytest.approx(ell().volume, rel=1e-5)


# --- bodies ---


def test_overlapping_bodies_are_united(save: Save, caplog: pytest.LogCaptureFixture) -> None:
    pin, head = creation.cylinder(radius=0.006, height=0.06), creation.cylinder(radius=0.015, height=0.012)
    with caplog.at_level(logging.INFO):
        mesh = read_mesh(save(trimesh.util.concatenate([pin, head])))
    assert mesh.volume == pytest.approx(trimesh.boolean.union([pin, head], engine="manifold").volume, rel=1e-5)
    assert caplog.text.count("they were united") == 1


def test_flush_bodies_are_united(save: Save) -> None:
    width = 0.02
    lower, upper = creation.box((0.03, 0.03, 0.02)), creation.box((width, width, 0.02), at(0, 0, 0.02))
    mesh = read_mesh(save(trimesh.util.concatenate([lower, upper])))
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(0.03**2 * 0.02 + width**2 * 0.02, rel=1e-4)
    assert len(bodies_of(mesh)) == 1


def test_bodies_that_miss_each_other_by_rounding_are_united(save: Save) -> None:
    lower, upper = creation.box((0.03, 0.03, 0.02)), creation.box((0.02, 0.02, 0.02), at(0.001, 0, 0.02 + 2e-8))
    mesh = read_mesh(save(trimesh.util.concatenate([lower, upper]), "part.ply"))
    assert mesh.volume == pytest.approx(0.03**2 * 0.02 + 0.02**2 * 0.02, rel=1e-3)


def test_bodies_apart_are_refused_with_their_number(save: Save) -> None:
    boxes = [creation.box((0.01, 0.01, 0.01), at(x)) for x in (0.0, 0.02, 0.04)]
    with pytest.raises(ValueError, match=r"holds 3 bodies, of which 3 remain apart, but a part is one rigid body"):
        read_mesh(save(trimesh.util.concatenate(boxes)))


def test_a_cavity_stays(save: Save) -> None:
    void = creation.box((0.04, 0.024, 0.024))
    void.invert()
    mesh = read_mesh(save(trimesh.util.concatenate([creation.box((0.06, 0.04, 0.04)), void])))
    assert mesh.volume == pytest.approx(0.06 * 0.04 * 0.04 - 0.04 * 0.024 * 0.024, rel=1e-5)


def test_cavities_go_with_their_bodies() -> None:
    void, solid = creation.box((0.01, 0.01, 0.01), at(0.05)), creation.box((0.02, 0.02, 0.02), at(0.05))
    void.invert()
    bodies = bodies_of(trimesh.util.concatenate([creation.box((0.03, 0.03, 0.03)), void, solid]))
    assert sorted(round(body.volume * 1e9) for body in bodies) == [7000, 27000]


# --- repair ---


def soup(mesh: trimesh.Trimesh, noise: float) -> trimesh.Trimesh:
    """Return triangles without common vertices, whose corners differ by up to ``noise``."""
    corners = np.asarray(mesh.triangles).reshape(-1, 3)
    corners = corners + np.random.default_rng(0).uniform(-noise, noise, corners.shape)
    return trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)


@pytest.mark.parametrize("noise", [1e-9, 1e-7, 1e-6])
def test_corners_that_differ_by_rounding_are_merged(save: Save, noise: float, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        mesh = read_mesh(save(soup(ell(), noise), "part.ply"))
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(ell().volume, rel=1e-3)


@pytest.mark.parametrize("mesh", [ell(), creation.box((0.03, 0.04, 0.05))])
def test_corners_that_differ_by_more_than_rounding_are_refused_as_open(save: Save, mesh: trimesh.Trimesh) -> None:
    faces = len(mesh.faces)
    text = rf"{3 * faces} of {3 * faces} edges are open .*; corners that should be one lie about ([\d.e-]+) apart"
    with pytest.raises(
        ValueError, match=text + r" .* those up to [5-9].\de-06 apart \(0\.01 % of the extent\) are"
    ) as caught:
        read_mesh(save(soup(mesh, 5e-5), "part.ply"))
    found = re.search(text, str(caught.value))
    assert found is not None
    assert 1e-5 < float(found.group(1)) < 1e-4


def test_the_corners_of_true_holes_are_not_said_to_be_one(save: Save) -> None:
    """Ten triangles are missing, each 60 mm long and 2 mm wide, which meet in corners."""
    tube = creation.cylinder(radius=0.02, height=0.06, sections=64)
    side = np.flatnonzero(np.abs(tube.face_normals[:, 2]) < 0.5)
    lower = side[tube.triangles_center[side, 2] < 0]
    angles = np.arctan2(*tube.triangles_center[lower, :2].T)
    kept = np.ones(len(tube.faces), np.bool_)
    kept[lower[np.argsort(angles)[:10]]] = False
    tube.update_faces(kept)
    with pytest.raises(ValueError, match=r"30 of \d+ edges are open and 0 .* or more; export the part as a solid"):
        read_mesh(save(tube))


def test_a_closed_part_with_a_lone_triangle_is_refused_as_open(save: Save) -> None:
    lone = trimesh.Trimesh([(0.1, 0, 0), (0.11, 0, 0), (0.1, 0.01, 0.002)], [(0, 1, 2)], process=False)
    with pytest.raises(ValueError, match=r"3 of \d+ edges are open .* more; export the part"):
        read_mesh(save(trimesh.util.concatenate([ell(), lone]), "part.ply"))


def test_a_mesh_without_any_volume_is_one_body() -> None:
    sheet = trimesh.Trimesh(np.eye(3), [(0, 1, 2), (0, 2, 1)], process=False)
    assert bodies_of(sheet) == [sheet]


def test_flat_holes_are_closed_however_wide(save: Save, caplog: pytest.LogCaptureFixture) -> None:
    tub = creation.cylinder(radius=0.02, height=0.06, sections=32)
    volume = tub.volume
    tub.update_faces(tub.triangles_center[:, 2] < 0.029)  # without its lid
    with caplog.at_level(logging.WARNING):
        assert read_mesh(save(tub)).volume == pytest.approx(volume, rel=1e-5)
    assert "holes up to 0.0398 wide and 0.04 long were closed (1)" in caplog.text


def test_a_slit_is_said_to_be_as_narrow_as_it_is(save: Save, caplog: pytest.LogCaptureFixture) -> None:
    """The upper face of a block ends 0.02 mm before one of its edges, which is more than is merged."""
    block = creation.box((0.06, 0.04, 0.02))
    vertices, faces = np.asarray(block.vertices), np.asarray(block.faces).copy()
    upper = block.face_normals[:, 2] > 0.5
    for vertex in np.flatnonzero(np.isclose(vertices[:, 1:], (0.02, 0.01)).all(axis=1)):
        faces[upper] = np.where(faces[upper] == vertex, len(vertices), faces[upper])
        vertices = np.vstack([vertices, vertices[vertex] - (0, 0.00002, 0)])
    with caplog.at_level(logging.WARNING):
        mesh = read_mesh(save(trimesh.Trimesh(vertices, faces, process=False), "part.ply"))
    assert mesh.volume == pytest.approx(block.volume, rel=1e-3)
    found = re.search(r"holes up to (\S+) wide and 0\.06 long were closed \(1\)", caplog.text)
    assert found is not None
    assert float(found.group(1)) == pytest.approx(0.00002, rel=0.5)


def test_a_flat_concave_hole_is_closed_by_faces_that_do_not_overlap(save: Save) -> None:
    whole = ell()
    cap = np.isclose(whole.triangles[:, :, 1], 0.015).all(axis=1)  # the L itself
    opened = trimesh.Trimesh(whole.vertices, whole.faces[~cap], process=False)
    assert not opened.is_watertight
    mesh = read_mesh(save(opened), "m")
    assert mesh.area == pytest.approx(whole.area, rel=1e-6)
    assert mesh.volume == pytest.approx(whole.volume, rel=1e-6)


def test_a_wide_hole_in_a_curved_surface_is_refused_with_advice(save: Save) -> None:
    half = creation.icosphere(subdivisions=3, radius=0.03)
    x, y, _ = half.triangles_center.T
    half.update_faces(x < 0.01 + 0.006 * np.cos(np.pi * y / 0.02))
    with pytest.raises(ValueError, match=r"edges are open .* more; export .* screened Poisson reconstruction"):
        read_mesh(save(half))


def test_a_sheet_without_volume(save: Save) -> None:
    corners = np.array([(0, 0, 0), (0.05, 0, 0), (0.05, 0.05, 0.02), (0, 0.05, 0)])
    sheet = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3), (0, 2, 1), (0, 3, 2)], process=False)
    with pytest.raises(ValueError, match=r"must (enclose a volume|be watertight)"):
        read_mesh(save(sheet))


def test_a_foil_is_refused_with_its_thickness(save: Save) -> None:
    with pytest.raises(ValueError, match=r"is 0\.05 mm thick, taken as m; the cell simulates parts from 0\.2 mm on"):
        read_mesh(save(creation.box((0.06, 0.04, 0.00005))))


@pytest.mark.parametrize(
    ("mesh", "sides"),
    [
        (creation.cylinder(radius=0.033, height=0.080, sections=64), (0.066, 0.066, 0.080)),
        (creation.box((0.06, 0.04, 0.02)), (0.02, 0.04, 0.06)),
    ],
)
def test_the_sides_are_those_of_the_least_box_however_the_part_is_turned(
    save: Save, mesh: trimesh.Trimesh, sides: tuple[float, float, float]
) -> None:
    turn = trimesh.transformations.rotation_matrix(0.5, (1.0, 0.3, 0.2))
    assert read_mesh(save(mesh.copy().apply_transform(turn))).metadata["sides"] == pytest.approx(sides, rel=0.002)


def test_a_tilted_foil_is_refused_with_its_thickness(save: Save) -> None:
    turn = trimesh.transformations.rotation_matrix(0.5, (1.0, 0.3, 0.2))
    foil = creation.box((0.06, 0.04, 0.00005)).apply_transform(turn)
    with pytest.raises(ValueError, match=r"is 0\.05 mm thick, taken as m"):
        read_mesh(save(foil))


@pytest.mark.parametrize("size", [1e-6, 10.0])
def test_parts_of_1_um_and_10_m(save: Save, size: float) -> None:
    path = save(creation.box((size, size, size)), "part.ply")
    with pytest.raises(ValueError, match=r"must be 0\.003 to 1 m, got .* --unit, in Python unit=, names another"):
        read_mesh(path, unit="m")


@pytest.mark.slow
def test_many_faces_are_simplified_to_a_stated_deviation(
    save: Save, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("binpick_env.parts.mesh_file.MAX_FACES", 20_000)
    fine = creation.cylinder(radius=0.02, height=0.05, sections=5)
    volume = fine.volume
    for _ in range(5):
        fine = fine.subdivide()
    with caplog.at_level(logging.WARNING):
        mesh = read_mesh(save(fine))
    assert mesh.volume == pytest.approx(volume, rel=1e-5)
    assert len(mesh.faces) < 2_000
    assert "has 20480 faces; it was simplified to" in caplog.text


def test_faces_that_cannot_be_fewer_are_refused(save: Save, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("binpick_env.parts.mesh_file.MAX_FACES", 3)
    with pytest.raises(ValueError, match=r"may have up to 3 faces, .* could not be simplified .* more coarsely"):
        read_mesh(save(ell()))


@pytest.mark.parametrize("first", range(6))
def test_a_concave_polygon_is_read_right_or_refused(tmp_path: Path, first: int) -> None:
    corners = np.array([(0, 0), (40, 0), (40, 20), (20, 20), (20, 40), (0, 40)], float)
    cap = np.roll(np.arange(6), -first)  # a fan from corner 0 or 3 covers the L, any other fills its notch
    points = [f"v {x} {y} {z}" for z in (0, 10) for x, y in corners]
    sides = [f"f {k + 1} {(k + 1) % 6 + 1} {(k + 1) % 6 + 7} {k + 7}" for k in range(6)]
    caps = ["f " + " ".join(str(k + 1) for k in np.roll(cap[::-1], 1)), "f " + " ".join(str(k + 7) for k in cap)]
    path = text(tmp_path / "ell.obj", "\n".join([*points, *sides, *caps]))
    if first in (0, 3):
        mesh = read_mesh(path)
        assert mesh.area == pytest.approx(2 * 1200e-6 + 160e-3 * 10e-3)
        assert mesh.volume == pytest.approx(1200e-6 * 10e-3)
    else:
        with pytest.raises(ValueError, match=r"triangles that lie on each other.*: triangulate the faces when export"):
            read_mesh(path)
