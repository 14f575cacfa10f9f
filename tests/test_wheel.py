import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("binpick_env", "perception", "policies")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the wheel that BINPICK_WHEEL names, as `make build` does, or build one."""
    if built := os.environ.get("BINPICK_WHEEL"):
        return Path(built).resolve(strict=True)
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    (path,) = folder.glob("*.whl")
    return path


@pytest.mark.slow
def test_the_wheel_holds_three_packages_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if not name.split("/")[0].endswith(".dist-info")}
    sources = {path for package in PACKAGES for path in (ROOT / package).rglob("*") if path.is_file()}
    assert names == {path.relative_to(ROOT).as_posix() for path in sources if "__pycache__" not in path.parts}


def take_compiled_kernels(site: Path) -> None:
    """Give the installed kernels what is compiled of equal sources here; numba compares times and sizes of files."""
    for package in PACKAGES:
        for source in (ROOT / package).rglob("*_kernels.py"):
            installed = site / source.relative_to(ROOT)
            assert installed.read_bytes() == source.read_bytes()
            shutil.copystat(source, installed)
            for compiled in (source.parent / "__pycache__").glob(f"{source.stem}.*.nb[ci]"):
                (installed.parent / "__pycache__").mkdir(exist_ok=True)
                shutil.copy2(compiled, installed.parent / "__pycache__")


@pytest.mark.slow
def test_the_wheel_works_alone_from_another_directory(wheel: Path, tmp_path: Path) -> None:
    target = tmp_path / "site"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*pip, "--target", str(target), str(wheel)], check=True, capture_output=True)
    take_compiled_kernels(target)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    command = [sys.executable, "-P", str(ROOT / "tests" / "smoke_test.py"), str(target)]
    environment = os.environ | {"PYTHONPATH": str(target), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, cwd=elsewhere, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"import binpick_env: \d+\.\d+ s\n", done.stdout)
    assert done.stdout.endswith("smoke test passed\n")
