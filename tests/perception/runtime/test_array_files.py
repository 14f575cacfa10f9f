"""NPY and NPZ files that announce more than they hold."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from perception.runtime import array_files as module
from perception.runtime.array_files import load_npy, load_npz


def announcing(shape: tuple[int, ...], content: bytes) -> bytes:
    """Return an NPY of float64 whose header announces a shape, whatever it holds."""
    header = io.BytesIO()
    facts = {"shape": shape, "fortran_order": False, "descr": "<f8"}
    np.lib.format.write_array_header_1_0(header, facts)
    return header.getvalue() + content


def test_arrays_come_back(tmp_path: Path) -> None:
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.int64(3), "c": np.str_("text"), "d": np.zeros((0, 3))}
    np.savez_compressed(tmp_path / "a.npz", **arrays)  # type: ignore[arg-type]
    loaded = load_npz(tmp_path / "a.npz")
    assert loaded.keys() == arrays.keys()
    for name, value in arrays.items():
        np.testing.assert_array_equal(loaded[name], value)
    np.save(tmp_path / "a.npy", arrays["a"])
    np.testing.assert_array_equal(load_npy(tmp_path / "a.npy"), arrays["a"])


def test_a_header_that_announces_more_than_there_is_takes_no_memory(tmp_path: Path) -> None:
    content = announcing((10**6, 10**6, 10**6), b"")
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.npy announces 8000000000000000000 bytes, an array of \(1000000, "):
        load_npy(tmp_path / "a.npy")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("depth.npy", content)
    with pytest.raises(ValueError, match=r"depth\.npy in a\.npz announces 8\d* bytes, .* but holds 0"):
        load_npz(tmp_path / "a.npz")


def test_files_that_would_fill_the_memory_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LARGEST", 10_000)
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(1000), b=np.zeros(1000))
    assert (tmp_path / "a.npz").stat().st_size < 1000
    with pytest.raises(ValueError, match=r"a\.npz must hold at most 1e-05 GB, got 1\.6\d*e-05 GB"):
        load_npz(tmp_path / "a.npz")
    np.save(tmp_path / "a.npy", np.zeros(2000))
    with pytest.raises(ValueError, match=r"a\.npy must hold at most 1e-05 GB, got 1\.61e-05 GB"):
        load_npy(tmp_path / "a.npy")


def test_objects_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", a=np.array([{}], dtype=object))
    with pytest.raises(ValueError, match="Object arrays cannot be loaded when allow_pickle=False"):
        load_npz(tmp_path / "a.npz")


def test_headers_of_unknown_versions_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x09\x00" + b"\0" * 20)
    with pytest.raises(ValueError, match=r"a\.npy must be NPY of version 1\.0 or 2\.0, got \(9, 0\)"):
        load_npy(tmp_path / "a.npy")
