"""The cache: answers from disk, keys that tell contents apart, and damage that costs time only."""

import logging
import os
import tempfile
from pathlib import Path

import numpy as np
import platformdirs
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from perception.runtime.cache import Arrays, cache_folder, cached_arrays, digest


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def refuse() -> Arrays:
    raise RuntimeError("computed, although it is stored")


def table() -> Arrays:
    return {"a": np.arange(6.0).reshape(2, 3), "b": np.array([True, False]), "none": np.zeros((0, 3))}


def test_the_folder_is_the_users_or_the_one_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cache_folder() == folder
    for value in ("", None):
        monkeypatch.setenv("BINPICK_CACHE", value) if value is not None else monkeypatch.delenv("BINPICK_CACHE")
        assert cache_folder() == Path(platformdirs.user_cache_dir("binpick"))


def test_what_was_computed_comes_from_disk(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", logger="perception")
    first = cached_arrays("things", "k", table)
    assert caplog.messages == [f"preparing the part: things, once, kept in {folder}"]
    again = cached_arrays("things", "k", refuse)
    assert len(caplog.messages) == 1
    assert sorted(again) == ["a", "b", "none"]
    for name, array in first.items():
        np.testing.assert_array_equal(again[name], array)
        assert again[name].dtype == array.dtype
    assert [path.name for path in folder.iterdir()] == ["things-k.npz"]


@pytest.mark.parametrize(("kind", "key"), [("things", "other"), ("others", "k")])
def test_another_kind_or_key_is_computed(folder: Path, kind: str, key: str) -> None:
    cached_arrays("things", "k", table)
    with pytest.raises(RuntimeError, match="computed"):
        cached_arrays(kind, key, refuse)


@pytest.mark.parametrize("damage", [b"", b"no zip file at all", None])
def test_a_damaged_file_is_computed_anew(folder: Path, caplog: pytest.LogCaptureFixture, damage: bytes | None) -> None:
    cached_arrays("things", "k", table)
    path = folder / "things-k.npz"
    path.write_bytes(path.read_bytes()[:-30] if damage is None else damage)
    with caplog.at_level(logging.WARNING):
        found = cached_arrays("things", "k", table)
    np.testing.assert_array_equal(found["a"], table()["a"])
    assert "computing it anew" in caplog.text
    np.testing.assert_array_equal(cached_arrays("things", "k", refuse)["a"], table()["a"])


def test_a_folder_that_cannot_be_written_costs_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "file" / "cache"))
    with caplog.at_level(logging.WARNING):
        found = cached_arrays("things", "k", table)
    np.testing.assert_array_equal(found["a"], table()["a"])
    assert "cannot write" in caplog.text


def test_a_read_only_home_costs_nothing_but_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "home").write_text("in the way")
    monkeypatch.delenv("BINPICK_CACHE", raising=False)
    monkeypatch.setattr(platformdirs, "user_cache_dir", lambda name: str(tmp_path / "home" / name))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with caplog.at_level(logging.INFO, logger="perception"):
        cached_arrays("things", "k", table)
    spare = tmp_path / f"binpick-cache-{os.getuid()}"
    assert caplog.messages == [f"preparing the part: things, once, kept in {spare}"]
    np.testing.assert_array_equal(cached_arrays("things", "k", refuse)["a"], table()["a"])
    assert (spare / "things-k.npz").exists()
    assert spare.stat().st_mode & 0o777 == 0o700
    # A folder of another user is not trusted.
    monkeypatch.setattr(os, "getuid", lambda: spare.stat().st_uid + 1)
    (tmp_path / f"binpick-cache-{os.getuid()}").mkdir()
    with pytest.raises(RuntimeError, match="computed"):
        cached_arrays("things", "k", refuse)


def test_a_write_that_fails_leaves_nothing_behind(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_space(*_: object, **__: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(np, "savez", no_space)
    cached_arrays("things", "k", table)
    assert list(folder.iterdir()) == []


def test_a_failed_computation_is_not_stored(folder: Path) -> None:
    with pytest.raises(RuntimeError, match="computed"):
        cached_arrays("things", "k", refuse)
    assert list(folder.iterdir()) == []


# --- digests


def test_a_digest_tells_contents_apart() -> None:
    contents: list[tuple[object, ...]] = [
        (np.zeros(4),),
        (np.zeros(4, np.float32),),
        (np.zeros((2, 2)),),
        (np.zeros(4), np.zeros(0)),
        (np.zeros(4), 1),
        (np.zeros(4), 1.0),
        (np.zeros(4), "1"),
        ("ab", "c"),
        ("a", "bc"),
        (),
    ]
    assert len({digest(*content) for content in contents}) == len(contents)


@given(array=hnp.arrays(np.float64, st.tuples(st.integers(1, 4), st.integers(1, 4))), index=st.integers(0, 100))
def test_a_digest_depends_on_values_and_not_on_memory(array: np.ndarray, index: int) -> None:
    assert digest(array) == digest(np.asfortranarray(array)) == digest(array.copy())
    other = array.copy()
    other.flat[index % array.size] = np.nextafter(np.nan_to_num(other.flat[index % array.size]), 1e300)
    assert digest(other) != digest(array)
