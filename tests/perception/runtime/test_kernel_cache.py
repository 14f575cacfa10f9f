"""Kernels are kept in a folder that can be written, wherever the package is installed."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest

import perception
from perception.runtime import kernel_cache
from perception.runtime.kernel_cache import first_writable, temporary_folders, use_writable_kernel_cache

PACKAGE = Path(perception.__file__).parent


@pytest.fixture
def _as_before(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")


@pytest.mark.usefixtures("_as_before")
def test_numbas_own_folders_come_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel_cache, "_is_writable", lambda folder: True)
    use_writable_kernel_cache()
    assert (os.environ["NUMBA_CACHE_DIR"], numba.config.CACHE_DIR) == ("", "")


@pytest.mark.usefixtures("_as_before")
@pytest.mark.parametrize(("writable", "kept"), [("cache/", "cache/kernels"), ("binpick-", "/binpick-kernels-")])
def test_where_those_are_read_only_the_cache_folder_serves_or_a_temporary_one(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, writable: str, kept: str
) -> None:
    monkeypatch.setattr(kernel_cache, "_PACKAGE", Path("/read/only"))
    monkeypatch.setattr(kernel_cache, "_is_writable", lambda folder: f"/{writable}" in str(folder))
    monkeypatch.setattr(kernel_cache, "_numbas_user_folder", lambda: Path("/read/only"))
    use_writable_kernel_cache()
    assert kept in os.environ["NUMBA_CACHE_DIR"]
    assert os.environ["NUMBA_CACHE_DIR"] == numba.config.CACHE_DIR


@pytest.mark.usefixtures("_as_before")
def test_a_folder_of_the_users_is_obeyed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/of/the/user")
    monkeypatch.setattr(kernel_cache, "_is_writable", lambda folder: False)
    use_writable_kernel_cache()
    assert os.environ["NUMBA_CACHE_DIR"] == "/of/the/user"


def test_no_folder_at_all_is_left_to_numba(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the folder's place")
    assert first_writable([tmp_path / "file" / "a", tmp_path / "file"]) is None
    assert first_writable([tmp_path / "file" / "a", tmp_path / "b"]) == tmp_path / "b"


def test_a_machine_without_temporary_files_does_no_harm(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def none() -> str:
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr(kernel_cache.tempfile, "gettempdir", none)
    assert temporary_folders("kernels") == []
    monkeypatch.setattr(kernel_cache.tempfile, "gettempdir", lambda: str(tmp_path))
    assert temporary_folders("kernels") == [tmp_path / f"binpick-kernels-{os.getuid()}"]
    # A folder of another user is not trusted.
    monkeypatch.setattr(os, "getuid", lambda: tmp_path.stat().st_uid + 1)
    assert temporary_folders("kernels") == []


def test_a_package_and_a_home_that_cannot_be_written_do_no_harm(tmp_path: Path) -> None:
    copy = tmp_path / "perception"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("weights", "__pycache__"))
    for folder in (copy, *(path for path in copy.rglob("*") if path.is_dir())):
        (folder / "__pycache__").write_text("in the folder's place")
    code = "import os, perception._boundary_kernels; print(perception.__file__, os.environ['NUMBA_CACHE_DIR'])"
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA", "XDG", "PYTHON"))}
    environment = kept | {"HOME": "/dev/null", "BINPICK_CACHE": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(copy / "__init__.py"), str(tmp_path / "cache" / "kernels")]
