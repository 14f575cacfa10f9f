"""A record is read as it was written; a file of another kind or version says what to do."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from perception.runtime import array_files
from perception.runtime.records import RecordError, RecordFormat


class DrawingError(RecordError):
    """A file holds no drawing."""


FORMAT = RecordFormat(kind="drawing", version=2, remedy="draw makes drawings", error=DrawingError)
OTHER = replace(FORMAT, kind="painting")


def save(form: RecordFormat, path: Path) -> None:
    """Write a record in the layout of the path's suffix."""
    if path.suffix == ".npz":
        form.save_arrays(path, {"x": np.arange(3)})
    elif path.suffix == ".json":
        form.save_plain(path, {"x": [0, 1, 2]})
    else:
        form.save_tensors(path, {"x": torch.arange(3)}, {"y": 4})


def load(form: RecordFormat, path: Path) -> Any:
    """Read a record's x in the layout of the path's suffix."""
    if path.suffix == ".npz":
        return form.load_arrays(path, lambda arrays: arrays["x"].tolist())
    if path.suffix == ".json":
        return form.load_plain(path, lambda values: values["x"])
    return form.load_tensors(path, lambda _, tensors: tensors["x"].tolist())


SUFFIXES = pytest.mark.parametrize("suffix", ["npz", "json", "safetensors"])


@SUFFIXES
def test_a_record_is_read_as_it_was_written_and_no_draft_is_left(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / "new" / f"a.{suffix}"
    save(FORMAT, path)
    assert load(FORMAT, path) == [0, 1, 2]
    assert list(path.parent.iterdir()) == [path]
    assert path.stat().st_mode & 0o777 == 0o644


@SUFFIXES
def test_another_kind_and_version_are_refused_with_a_remedy(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    save(FORMAT, path)
    with pytest.raises(DrawingError, match=rf"a\.{suffix} must hold a painting, but it holds a drawing; draw makes"):
        load(OTHER, path)
    with pytest.raises(DrawingError, match=rf"a\.{suffix} is a drawing of version 2, this code reads 3; draw makes"):
        load(replace(FORMAT, version=3), path)
    with pytest.raises(DrawingError, match=r"is a drawing of version 2, this code reads 1; update binpick"):
        load(replace(FORMAT, version=1), path)


@SUFFIXES
def test_a_missing_or_cut_file_and_a_failing_reader_raise_the_formats_error(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    with pytest.raises(
        DrawingError, match=rf"a\.{suffix} does not hold a complete drawing \(.*No such file.*\); draw makes"
    ):
        load(FORMAT, path)
    save(FORMAT, path)
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(DrawingError, match=r"does not hold a complete drawing \(.+\); draw makes drawings"):
        load(FORMAT, path)


@SUFFIXES
def test_a_file_that_would_fill_the_memory_is_refused(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"a.{suffix}"
    save(FORMAT, path)
    monkeypatch.setattr(array_files, "LARGEST", 20)
    with pytest.raises(DrawingError, match=rf"\(a\.{suffix} must hold at most .* GB, got .* GB\); draw"):
        load(FORMAT, path)


def test_a_missing_field_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    save(FORMAT, path)
    with pytest.raises(DrawingError, match=r"does not hold a complete drawing \('y' is missing\)"):
        FORMAT.load_arrays(path, lambda arrays: arrays["y"])


def test_files_without_kind_and_version_are_of_version_1(tmp_path: Path) -> None:
    first = replace(FORMAT, version=1)
    np.savez(tmp_path / "a.npz", x=np.arange(3))
    (tmp_path / "a.json").write_text('{"x": [0, 1, 2]}')
    save_file({"x": torch.arange(3)}, tmp_path / "a.safetensors", {"record": "{}"})
    save_file({"x": torch.arange(3)}, tmp_path / "b.safetensors", {"training": '{"version": 1}'})
    for path in sorted(tmp_path.iterdir()):
        assert load(first, path) == [0, 1, 2]
        with pytest.raises(DrawingError, match="is a drawing of version 1, this code reads 2"):
            load(FORMAT, path)


def test_a_tensor_file_without_a_header_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    save_file({"x": torch.arange(3)}, path)
    with pytest.raises(DrawingError, match=r"does not hold a complete drawing \(it has no header\)"):
        FORMAT.load_header(path)


def test_a_header_is_read_without_the_tensors(tmp_path: Path) -> None:
    text = FORMAT.save_tensors(tmp_path / "a.safetensors", {"x": torch.zeros(1)}, {"loss": float("nan")})
    assert FORMAT.load_header(tmp_path / "a.safetensors") == {"version": 2, "loss": None}
    assert text == '{\n "version": 2,\n "loss": null\n}'


def test_plain_values_may_be_written_on_one_line(tmp_path: Path) -> None:
    FORMAT.save_plain(tmp_path / "a.json", {"x": [1, float("nan")]}, indent=None)
    assert (tmp_path / "a.json").read_text() == '{"kind":"drawing","version":2,"x":[1,null]}'


def test_arrays_are_compressed_unless_told_otherwise(tmp_path: Path) -> None:
    zeros = np.zeros(10_000)
    FORMAT.save_arrays(tmp_path / "a.npz", {"x": zeros})
    FORMAT.save_arrays(tmp_path / "b.npz", {"x": zeros}, compressed=False)
    assert (tmp_path / "a.npz").stat().st_size < zeros.nbytes / 10
    assert (tmp_path / "b.npz").stat().st_size > zeros.nbytes


def test_the_module_does_not_import_torch() -> None:
    code = "import perception.runtime.records, sys; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
