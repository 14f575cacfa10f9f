"""The catalogue, symmetry detection, convex pieces, and the door for mesh files."""

import gc
import logging
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from binpick_env.parts import (
    CATALOGUE,
    Part,
    PieceSettings,
    SymmetrySettings,
    convex_pieces,
    detect_symmetry,
    load_part,
    symmetry_error,
)
from binpick_env.parts.surface import SurfaceProbe
from perception.geometry import make_transform, random_rotation, rotation_about
from perception.part import Symmetry

seeds = st.integers(0, 2**32 - 1)
creation = trimesh.creation
FAST = PieceSettings(iterations=10, resolution=200)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache"
    monkeypatch.setenv("BINPICK_CACHE", str(folder))
    return folder


@pytest.fixture(params=CATALOGUE)
def part(request: pytest.FixtureRequest) -> Part:
    return load_part(request.param)


def ell() -> trimesh.Trimesh:
    """Return an L of 60 x 40 x 30 mm, legs of 10 mm: two convex pieces, no symmetry."""
    foot, wall = creation.box((0.06, 0.03, 0.01)), creation.box((0.01, 0.03, 0.04))
    foot.apply_translation((0.03, 0, 0.005))
    wall.apply_translation((0.005, 0, 0.02))
    return trimesh.boolean.union([foot, wall], engine="manifold")


def naive_distance(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Return each point's distance to the nearest of all triangles."""
    triangles = np.asarray(mesh.triangles)
    closest = [trimesh.triangles.closest_point(triangles, np.tile(p, (len(triangles), 1))) for p in points]
    return np.array([np.linalg.norm(c - p, axis=1).min() for c, p in zip(closest, points, strict=True)])


# --- the catalogue ---


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


# --- symmetry ---


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


def test_a_sphere_has_no_orientation() -> None:
    with pytest.raises(ValueError, match="the part is a sphere: its orientation has no meaning"):
        detect_symmetry(creation.icosphere(subdivisions=4, radius=0.03))


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
    np.testing.assert_array_less(naive - 1e-12, found)
    np.testing.assert_allclose(found, naive, atol=2e-4)


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


# --- convex pieces ---


def test_coacd_cuts_an_ell_in_two_and_repeats_itself(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = ell()
    first = convex_pieces(mesh)
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "another"))
    second = convex_pieces(mesh)
    assert len(first) == len(second) == 2
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)
    covered = trimesh.boolean.union(list(first), engine="manifold").volume
    assert covered == pytest.approx(mesh.volume, rel=0.05)


def test_coacd_covers_a_bored_wheel(cache: Path) -> None:
    outline = [(0.006, 0.0), (0.04, 0.0), (0.04, 0.013), (0.02, 0.013), (0.02, 0.047), (0.006, 0.047), (0.006, 0.0)]
    mesh = creation.revolve(outline, sections=24)  # part_a with coarse facets: a quarter of the time
    pieces = convex_pieces(mesh, PieceSettings(iterations=20, resolution=500))
    assert len(pieces) <= 16
    assert max(len(piece.vertices) for piece in pieces) <= 64
    covered = trimesh.boolean.union(list(pieces), engine="manifold")
    assert covered.volume == pytest.approx(mesh.volume, rel=0.05)
    outer = mesh.vertices[naive_distance(mesh.convex_hull, mesh.vertices) < 1e-9]
    assert naive_distance(covered, outer[::5]).max() < 1.5e-3


def test_the_cache_answers_the_second_time(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import coacd

    first = convex_pieces(ell(), FAST)
    assert len(list(cache.rglob("*.npz"))) == 1
    monkeypatch.setattr(coacd, "run_coacd", None)  # a second cut would fail
    second = convex_pieces(ell(), FAST)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)
        np.testing.assert_array_equal(a.faces, b.faces)
        assert b.is_watertight


def test_the_cache_tells_meshes_and_settings_apart(cache: Path) -> None:
    convex_pieces(ell(), FAST)
    moved = ell()
    moved.apply_translation((0.001, 0, 0))
    convex_pieces(moved, FAST)
    convex_pieces(ell(), PieceSettings(iterations=11, resolution=200))
    assert len(list(cache.rglob("*.npz"))) == 3
    assert [path for path in cache.rglob("*") if path.is_file() and path.suffix != ".npz"] == []


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # numpy leaves a broken .npz open
@pytest.mark.parametrize("damage", ["truncated", "garbage", "empty"])
def test_a_damaged_cache_file_is_computed_anew(cache: Path, caplog: pytest.LogCaptureFixture, damage: str) -> None:
    first = convex_pieces(ell(), FAST)
    (path,) = cache.rglob("*.npz")
    content = path.read_bytes()
    path.write_bytes({"truncated": content[: len(content) // 2], "garbage": b"not an archive", "empty": b""}[damage])
    with caplog.at_level(logging.WARNING):
        again = convex_pieces(ell(), FAST)
    assert len(again) == len(first)
    assert str(path) in caplog.text
    gc.collect()  # so that the open file is reported here and not in another test
    assert len(convex_pieces(ell(), FAST)) == len(first)


def test_a_cache_that_cannot_be_written_costs_a_warning_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("in the folder's place")
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "file" / "cache"))
    with caplog.at_level(logging.WARNING):
        assert len(convex_pieces(ell(), FAST)) == 2
    assert "cannot write" in caplog.text


def test_no_piece_at_all_is_an_error(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import coacd

    monkeypatch.setattr(coacd, "run_coacd", lambda *_, **__: [])
    with pytest.raises(ValueError, match="CoACD found no convex piece in a mesh of"):
        convex_pieces(ell(), FAST)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"threshold": 0.0}, r"threshold must be in \[0.01, 1\], got 0.0"),
        ({"max_pieces": 0}, "max_pieces must be at least 1, got 0"),
        ({"max_vertices": 4}, "max_vertices must be at least 8, got 4"),
        ({"iterations": 0}, "iterations must be at least 1, got 0"),
        ({"resolution": 10}, "resolution must be at least 100, got 10"),
    ],
)
def test_piece_settings_reject(arguments: dict[str, int], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PieceSettings(**arguments)  # type: ignore[arg-type]


# --- one door ---


@pytest.fixture
def save(tmp_path: Path, cache: Path) -> Callable[..., Path]:
    def save_mesh(mesh: trimesh.Trimesh, name: str = "part.stl", scale: float = 1.0) -> Path:
        mesh = mesh.copy()
        mesh.apply_scale(scale)
        mesh.export(tmp_path / name)
        return tmp_path / name

    return save_mesh


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


def test_a_catalogue_part_as_a_file_is_the_same_part(save: Callable[..., Path]) -> None:
    drawn = load_part("part_c")
    part = load_part(save(drawn.model.mesh, "part_c.ply"), density=drawn.density)
    assert part.model.d_max == pytest.approx(drawn.model.d_max, rel=1e-5)
    assert part.mass == pytest.approx(drawn.mass, rel=1e-5)
    np.testing.assert_allclose(part.inertia, drawn.inertia, rtol=1e-4, atol=1e-9)
    assert part.model.symmetry.order == drawn.model.symmetry.order


def test_catalogue_parts_are_built_once_and_cannot_be_changed() -> None:
    assert load_part("tee") is load_part("tee")
    assert load_part("tee", density=1000.0).mass == pytest.approx(load_part("tee").mass * 1000 / 1400)
    with pytest.raises(ValueError, match="immutable"):
        load_part("tee").model.mesh.vertices = np.zeros((3, 3))
    assert load_part("tee").model.mesh.copy().apply_scale(2.0).volume == pytest.approx(
        8 * load_part("tee").model.mesh.volume
    )


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


def test_a_part_too_wide_for_the_jaw_is_said(save: Callable[..., Path], caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        load_part(save(creation.box((0.08, 0.081, 0.082))), symmetry="none")
    assert "no side of" in caplog.text
    assert "is under 75 mm (the smallest: 80 mm): the jaw cannot grasp it" in caplog.text
    caplog.clear()
    load_part(save(creation.box((0.07, 0.081, 0.082)), "narrow.stl"), symmetry="none")
    assert "the jaw" not in caplog.text


def test_an_unknown_name_lists_the_names() -> None:
    with pytest.raises(
        ValueError, match=r"part must be one of part_a, part_b, part_c, tee, bracket, or a path .*'gear'"
    ):
        load_part("gear")


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"there is no part file .*gear\.stl"):
        load_part(tmp_path / "gear.stl")


@pytest.mark.parametrize("name", ["gear.step", "gear"])
def test_an_unsupported_suffix(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("solid")
    with pytest.raises(ValueError, match=r"a part's file must end in \.stl, \.obj, \.ply, got .*gear"):
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
    with pytest.raises(ValueError, match=r"flat\.obj is flat: a part must enclose a volume"):
        load_part(tmp_path / "flat.obj")


def test_vertices_that_are_not_finite(tmp_path: Path) -> None:
    (tmp_path / "nan.obj").write_text("v 0 0 0\nv nan 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n")
    with pytest.raises(ValueError, match=r"nan\.obj (has vertices that are not finite|is flat)"):
        load_part(tmp_path / "nan.obj")


def test_an_unclear_unit_lists_the_readings(save: Callable[..., Path]) -> None:
    path = save(creation.box((2.0, 2.0, 1.0)))
    with pytest.raises(
        ValueError, match=r"unit of .* is unclear: its largest diameter is 3, .* 3 m as 'm', 0.003 m as 'mm'"
    ):
        load_part(path)
    assert load_part(path, unit="inch").model.d_max == pytest.approx(3 * 0.0254, rel=1e-5)


@pytest.mark.parametrize("size", [0.010, 0.130])
def test_a_part_too_small_or_too_large(save: Callable[..., Path], size: float) -> None:
    with pytest.raises(ValueError, match=r"largest diameter of .* must be 0.02 to 0.2 m, got 0\.\d+ m"):
        load_part(save(creation.box((size, size, size))))


def test_too_many_faces_suggests_what_to_do(save: Callable[..., Path]) -> None:
    mesh = creation.icosphere(subdivisions=7, radius=0.03)
    with pytest.raises(ValueError, match=r"may have up to 200000 faces, .* has 327680: simplify it first"):
        load_part(save(mesh))


@pytest.mark.parametrize("density", [0.0, -1.0, np.nan, np.inf, 1e6])
def test_a_bad_density(density: float) -> None:
    with pytest.raises(ValueError, match=r"density must be 10 to 25000 kg/m\^3"):
        load_part("tee", density=density)


def test_bad_choices(save: Callable[..., Path]) -> None:
    with pytest.raises(ValueError, match="symmetry must be 'detect', 'none' or a Symmetry, got 'some'"):
        load_part("tee", symmetry="some")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="unit must be one of m, mm, cm, inch, got 'feet'"):
        load_part(save(ell()), unit="feet")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="unit belongs to mesh files; 'tee' is a catalogue part"):
        load_part("tee", unit="mm")


def test_importing_parts_imports_neither_torch_nor_coacd() -> None:
    code = "import sys, binpick_env.parts; sys.exit('torch' in sys.modules or 'coacd' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, env=os.environ.copy()).returncode == 0
