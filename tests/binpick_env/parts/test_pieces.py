"""A mesh cut into convex pieces, and the cache that keeps them."""

import gc
import logging
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from binpick_env.parts import PieceSettings, convex_pieces, pieces
from binpick_env.parts.decomposition import decompose
from binpick_env.parts.hull import _planes, distance_outside
from binpick_env.parts.simplification import simplified
from binpick_env.parts.surface import hausdorff_distance
from tests.binpick_env.parts.part_meshes import ell, naive_distance

creation = trimesh.creation
FAST = PieceSettings(iterations=10, resolution=200)


def test_coacd_cuts_an_ell_in_two_and_repeats_itself(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pieces, "decompose", decompose)
    mesh = ell()
    first = convex_pieces(mesh)
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "another"))
    second = convex_pieces(mesh)
    assert len(first) == len(second) == 2
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)
    covered = trimesh.boolean.union(list(first), engine="manifold").volume
    assert covered == pytest.approx(mesh.volume, rel=0.05)


@pytest.mark.slow
def test_coacd_covers_a_bored_wheel(cache: Path) -> None:
    outline = [(0.006, 0.0), (0.04, 0.0), (0.04, 0.013), (0.02, 0.013), (0.02, 0.047), (0.006, 0.047), (0.006, 0.0)]
    mesh = creation.revolve(outline, sections=24)  # part_a with coarse facets: a quarter of the time
    found = convex_pieces(mesh, PieceSettings(iterations=20, resolution=500))
    assert len(found) <= 16
    assert max(len(piece.vertices) for piece in found) <= 64
    covered = trimesh.boolean.union(list(found), engine="manifold")
    assert covered.volume == pytest.approx(mesh.volume, rel=0.05)
    outer = mesh.vertices[naive_distance(mesh.convex_hull, mesh.vertices) < 1e-9]
    assert naive_distance(covered, outer[::5]).max() < 1.5e-3


def test_the_cache_answers_the_second_time(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = convex_pieces(ell(), FAST)
    assert len(list(cache.rglob("*.npz"))) == 1
    monkeypatch.setattr(pieces, "decompose", None)  # a second cut would fail
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


def egg(subdivisions: int) -> trimesh.Trimesh:
    mesh = creation.icosphere(subdivisions=subdivisions)
    mesh.apply_scale((0.024, 0.02, 0.016))
    return mesh


def test_a_convex_mesh_is_its_own_piece_and_keeps_its_volume(
    cache: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(pieces, "decompose", None)
    with caplog.at_level(logging.INFO):
        (piece,) = convex_pieces(egg(5))
    assert len(piece.vertices) <= 64
    assert piece.is_volume
    assert piece.volume == pytest.approx(egg(5).volume, rel=1e-6)
    assert hausdorff_distance(egg(5), piece) < 0.0012
    assert re.search(r"a hull of 10242 vertices was thinned to 64; it deviates by at most [01]\.\d\d mm", caplog.text)


def test_a_dented_mesh_is_not_convex(cache: Path) -> None:
    assert len(convex_pieces(ell(), FAST)) == 2


def dumbbell() -> trimesh.Trimesh:
    outline = [(0.0, -0.04), (0.015, -0.035), (0.015, -0.02), (0.006, -0.015), (0.006, 0.015), (0.015, 0.02)]
    mesh = creation.revolve([*outline, (0.015, 0.035), (0.0, 0.04)], sections=256)
    return mesh.subdivide()


@pytest.mark.slow
def test_many_faces_are_simplified_before_they_are_cut(cache: Path, caplog: pytest.LogCaptureFixture) -> None:
    mesh = dumbbell()
    assert len(mesh.faces) > 10_000
    with caplog.at_level(logging.INFO):
        found = convex_pieces(mesh, FAST)
    assert "faces were simplified to" in caplog.text
    assert sum(piece.volume for piece in found) == pytest.approx(mesh.volume, rel=0.15)


@pytest.mark.parametrize("failure", ["signal", "missing pieces"])
def test_a_cut_that_fails_or_misses_a_piece_is_made_again_with_remeshing(
    cache: Path, monkeypatch: pytest.MonkeyPatch, failure: str
) -> None:
    modes = []

    def cut(mesh: trimesh.Trimesh, settings: dict[str, float | str], **options: float) -> list[np.ndarray]:
        modes.append(settings.get("preprocess_mode", "auto"))
        if modes[-1] == "off" and failure == "signal":
            raise ValueError("ended by a signal")
        corners = np.asarray(mesh.vertices)
        halves = [corners[side * corners[:, 2] > -0.016] for side in (1, -1)]
        return halves[:1] if modes[-1] == "off" else halves

    monkeypatch.setattr(pieces, "decompose", cut)
    assert len(convex_pieces(dumbbell(), FAST)) == 2
    assert modes == ["off", "auto"]


@pytest.mark.slow
def test_the_pieces_of_a_simplified_mesh_add_little_volume(cache: Path) -> None:
    found = convex_pieces(dumbbell(), PieceSettings(iterations=15, resolution=300))
    covered = trimesh.boolean.union(list(found), engine="manifold").volume
    assert covered == pytest.approx(dumbbell().volume, rel=0.04)


def test_the_distance_outside_of_hulls_is_that_of_the_worst_point() -> None:
    left, right = np.asarray(creation.box((0.02, 0.02, 0.02)).vertices), np.asarray(moved_box(0.03).vertices)
    points = np.array([(0.0, 0, 0), (0.03, 0, 0), (0.014, 0, 0)])
    assert distance_outside(points[:2], [left, right]) == 0
    assert distance_outside(points, [left, right]) == pytest.approx(0.004)
    assert distance_outside(points, [left, left[:3], np.zeros((5, 3))]) == pytest.approx(0.02)
    assert distance_outside(points, []) == np.inf


def moved_box(x: float) -> trimesh.Trimesh:
    return creation.box((0.02, 0.02, 0.02), transform=moved(x))


def test_planes_of_a_hull_are_those_of_trimesh_bit_by_bit() -> None:
    rng = np.random.default_rng(0)
    clouds = [rng.normal(size=(40, 3)), np.asarray(creation.cylinder(0.01, 0.02, sections=32).vertices)]
    for points in clouds:
        normals, places = _planes(points)
        hull = trimesh.convex.convex_hull(points)
        np.testing.assert_array_equal(normals, hull.face_normals)
        np.testing.assert_array_equal(places, hull.triangles[:, 0])


def test_simplification_states_the_deviation_it_measured() -> None:
    mesh = dumbbell()
    coarse = simplified(mesh, 0.0004)
    assert coarse is not None
    assert 0 < coarse.metadata["deviation"] == hausdorff_distance(mesh, coarse) <= 0.0004


@pytest.mark.slow
def test_simplification_keeps_walls_and_states_when_it_cannot() -> None:
    drilled = [creation.box((0.06, 0.04, 0.001))]
    drilled += [
        creation.cylinder(radius=0.004, height=0.01, sections=128, transform=moved(x)) for x in (-0.02, 0, 0.02)
    ]
    plate = trimesh.boolean.difference(drilled, engine="manifold")
    coarse = simplified(plate, 0.0007)
    assert coarse is not None
    assert coarse.is_watertight
    assert coarse.volume == pytest.approx(plate.volume, rel=0.02)
    assert len(coarse.faces) < len(plate.faces)
    assert hausdorff_distance(plate, coarse) <= 0.0007
    assert simplified(creation.box((0.06, 0.04, 0.0001)), 0.02) is None


def moved(x: float) -> np.ndarray:
    return trimesh.transformations.translation_matrix((x, 0, 0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("program", "message"),
    [
        (
            "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)",
            "of 36 faces ended by signal SIGSEGV: its surfaces",
        ),
        ("raise SystemExit('out of memory')", "the convex decomposition of a mesh of 36 faces failed: out of memory"),
        ("import os; os._exit(3)", "failed: no message"),
        ("import time; time.sleep(60)", r"took more than 1 s; simplify it first"),
    ],
)
def test_a_decomposition_that_ends_otherwise_is_an_error(tmp_path: Path, program: str, message: str) -> None:
    (tmp_path / "program.py").write_text(program)
    mesh = trimesh.Trimesh(ell().vertices, np.tile(ell().faces, (2, 1))[:36], process=False)
    message = message.replace("36", str(len(mesh.faces)))
    with pytest.raises(ValueError, match=message):
        decompose(mesh, {}, program=tmp_path / "program.py", timeout=1.0)


def test_no_piece_at_all_is_an_error(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "decompose", lambda *_, **__: [])
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
