"""A mesh cut into convex pieces, and the cache that keeps them."""

import gc
import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh

from binpick_env.parts import PieceSettings, convex_pieces
from tests.binpick_env.parts.part_meshes import ell, naive_distance

creation = trimesh.creation
FAST = PieceSettings(iterations=10, resolution=200)


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
