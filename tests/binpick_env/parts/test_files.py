"""The door for mesh files: what a file gives, and what is refused."""

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from binpick_env.parts import load_part
from perception.geometry import rotation_about
from perception.part import Symmetry
from tests.binpick_env.parts.part_meshes import ell

creation = trimesh.creation


# --- what a file gives ---


@pytest.fixture
def save(tmp_path: Path, cache: Path) -> Callable[..., Path]:
    def save_mesh(mesh: trimesh.Trimesh, name: str = "part.stl", scale: float = 1.0) -> Path:
        mesh = mesh.copy()
        mesh.apply_scale(scale)
        mesh.export(tmp_path / name)
        return tmp_path / name

    return save_mesh


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".STL"])
@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_a_file_gives_the_part_that_was_saved(save: Callable[..., Path], suffix: str, scale: float) -> None:
    mesh = ell()
    path = save(mesh, f"angle{suffix}", scale)
    part = load_part(path)
    assert part.model.name == "angle"
    assert part.source == str(path.resolve())
    assert part.model.d_max == pytest.approx(np.linalg.norm([0.06, 0.03, 0.04]), rel=1e-5)
    assert part.mass == pytest.approx(mesh.volume * 2700.0, rel=1e-5)
    np.testing.assert_allclose(part.model.centre, 0.0, atol=1e-9)
    assert part.model.symmetry.order == 1
    assert len(part.pieces) == 2


@settings(deadline=None, max_examples=8)
@given(st.sampled_from(["m", "mm", "cm", "inch"]))
def test_a_named_unit_is_obeyed(tmp_path_factory: pytest.TempPathFactory, unit: str) -> None:
    folder = tmp_path_factory.mktemp("unit")
    scale = {"m": 1.0, "mm": 1e3, "cm": 1e2, "inch": 1 / 0.0254}[unit]
    creation.box(np.array([0.03, 0.04, 0.05]) * scale).export(folder / "box.stl")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BINPICK_CACHE", str(folder))
        part = load_part(folder / "box.stl", unit=unit, symmetry="none")  # type: ignore[arg-type]
    assert part.model.d_max == pytest.approx(np.sqrt(0.03**2 + 0.04**2 + 0.05**2), rel=1e-5)


def test_millimetres_are_logged(save: Callable[..., Path], caplog: pytest.LogCaptureFixture) -> None:
    path = save(ell(), scale=1000.0)
    with caplog.at_level(logging.INFO):
        load_part(path)
    assert "is taken to be in millimetres: its largest diameter is 78.1" in caplog.text


def test_symmetry_choices(save: Callable[..., Path]) -> None:
    path = save(creation.box((0.03, 0.04, 0.05)))
    half_turn = Symmetry(rotations=np.stack([np.eye(3), rotation_about((0, 0, 1), np.pi)]))
    assert load_part(path).model.symmetry.order == 4
    assert load_part(path, symmetry="none").model.symmetry.order == 1
    assert load_part(path, symmetry=half_turn).model.symmetry is half_turn
    assert load_part("tee").model.symmetry.order == 2
    assert load_part("tee", symmetry="none").model.symmetry.order == 1
    assert load_part("part_a", symmetry=half_turn).model.symmetry is half_turn


@pytest.mark.slow
def test_a_catalogue_part_as_a_file_is_the_same_part(
    save: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("binpick_env.parts.part.convex_pieces", lambda mesh: (mesh.convex_hull,))  # those take a second
    drawn = load_part("part_c")
    part = load_part(save(drawn.model.mesh, "part_c.ply"), density=drawn.density)
    assert part.model.d_max == pytest.approx(drawn.model.d_max, rel=1e-5)
    assert part.mass == pytest.approx(drawn.mass, rel=1e-5)
    np.testing.assert_allclose(part.inertia, drawn.inertia, rtol=1e-4, atol=1e-9)
    assert part.model.symmetry.order == drawn.model.symmetry.order


def test_turned_normals_are_turned_back(save: Callable[..., Path]) -> None:
    mesh = ell()
    mesh.invert()
    part = load_part(save(mesh))
    assert part.model.mesh.volume == pytest.approx(ell().volume, rel=1e-5)
    mixed = ell()
    mixed.faces[::2] = mixed.faces[::2, ::-1]
    assert load_part(save(mixed, "mixed.ply")).mass == pytest.approx(part.mass, rel=1e-5)


def test_a_small_hole_is_closed_with_a_warning(save: Callable[..., Path], caplog: pytest.LogCaptureFixture) -> None:
    mesh = ell()
    mesh.update_faces(np.arange(1, len(mesh.faces)))
    with caplog.at_level(logging.WARNING):
        part = load_part(save(mesh))
    assert part.model.mesh.volume == pytest.approx(ell().volume, rel=1e-5)
    assert "was not watertight" in caplog.text


def test_a_file_is_read_once_until_it_changes(save: Callable[..., Path], caplog: pytest.LogCaptureFixture) -> None:
    path = save(creation.box((30, 40, 50)))
    with caplog.at_level(logging.INFO):
        first = load_part(path)
        assert load_part(str(path)) is first
        assert load_part(path, density=1000.0) is not first
        save(creation.box((30, 40, 60)))
        assert load_part(path).model.d_max > first.model.d_max
    assert caplog.text.count("is taken to be in millimetres") == 3
    assert load_part(path, symmetry="none") is load_part(path, symmetry="none")


# --- what is refused ---


def test_an_unknown_name_lists_the_names() -> None:
    with pytest.raises(
        ValueError,
        match=r"part must be one of part_a, part_b, part_c, tee, bracket, generated:FAMILY:INDEX, or a path .*'gear'",
    ):
        load_part("gear")


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"there is no part file .*gear\.stl"):
        load_part(tmp_path / "gear.stl")


@pytest.mark.parametrize("name", ["gear.iges", "gear"])
def test_an_unsupported_suffix(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("solid")
    with pytest.raises(ValueError, match=r"a part's file must end in \.stl, .* \.step, \.stp, got .*gear"):
        load_part(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.ply", b"not a mesh"), ("a.obj", b""), ("a.stl", b""), ("a.stl", b"\0" * 83), ("a.obj", b"v 0 0 0\nv 1 0 0\n")],
)
def test_an_unreadable_or_empty_file(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.\w+ (cannot be read as a \.\w+ mesh|holds no triangles)"):
        load_part(tmp_path / name)


def test_an_open_mesh_says_how_open(save: Callable[..., Path]) -> None:
    mesh = creation.cylinder(radius=0.02, height=0.06, sections=32)
    mesh.update_faces(mesh.triangles_center[:, 2] < 0.029)  # without its lid
    mesh.update_faces(np.arange(len(mesh.faces)) % 7 != 3)
    with pytest.raises(
        ValueError, match=r"must be watertight .* after repair \d+ of \d+ edges are open and 0 are shared by"
    ):
        load_part(save(mesh))


def test_a_flat_mesh_is_refused(tmp_path: Path) -> None:
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 0.05 0 0\nv 0 0.05 0\nf 1 2 3\n")
    with pytest.raises(ValueError, match=r"flat\.obj is flat, but a part must enclose a volume: give the"):
        load_part(tmp_path / "flat.obj")


def test_vertices_that_are_not_finite(tmp_path: Path) -> None:
    (tmp_path / "nan.obj").write_text("v 0 0 0\nv nan 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n")
    with pytest.raises(ValueError, match=r"nan\.obj (has vertices that are not finite: export|is flat)"):
        load_part(tmp_path / "nan.obj")


def test_an_unclear_unit_lists_the_readings(save: Callable[..., Path]) -> None:
    path = save(creation.box((2.0, 2.0, 1.0)))
    with pytest.raises(
        ValueError, match=r"unit of .* is unclear: its largest diameter is 3, .* 3 m as 'm', 0.003 m as 'mm'"
    ):
        load_part(path)
    assert load_part(path, unit="inch").model.d_max == pytest.approx(3 * 0.0254, rel=1e-5)


@pytest.mark.parametrize("size", [0.0015, 0.7])
def test_a_part_too_small_or_too_large(save: Callable[..., Path], size: float) -> None:
    with pytest.raises(ValueError, match=r"largest diameter of .* must be 0.003 to 1 m, got \d\.\d+ m"):
        load_part(save(creation.box((size, size, size))), unit="m")


@pytest.mark.parametrize("size", [0.003, 0.5])
def test_sizes_beyond_the_standard_cell_are_loaded(save: Callable[..., Path], size: float) -> None:
    part = load_part(save(creation.box((size, size, size))), unit="m", symmetry="none")
    assert part.model.d_max == pytest.approx(size * np.sqrt(3))
    assert part.sides == pytest.approx((size, size, size))


@pytest.mark.parametrize("density", [0.0, -1.0, np.nan, np.inf, 1e6])
def test_a_bad_density(density: float) -> None:
    with pytest.raises(ValueError, match=r"density must be 10 to 25000 kg/m\^3"):
        load_part("tee", density=density)


def test_bad_choices(save: Callable[..., Path]) -> None:
    with pytest.raises(ValueError, match="symmetry must be 'detect', 'none' or a Symmetry, got 'some'"):
        load_part("tee", symmetry="some")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="unit must be one of m, mm, cm, inch, got 'feet'"):
        load_part(save(ell()), unit="feet")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"symmetry_tolerance belongs to mesh files .* got 0.001 for 'tee'"):
        load_part("tee", symmetry_tolerance=0.001)
    with pytest.raises(ValueError, match="unit belongs to mesh files; 'tee' is a catalogue part"):
        load_part("tee", unit="mm")
