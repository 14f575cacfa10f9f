"""The compiled kernels never reach beyond an array: their tests pass where numba checks every index."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from perception.runtime.cache import cache_folder, digest

ROOT = Path(__file__).resolve().parents[2]
POSE_TESTS = Path(__file__).parent / "pose"
KERNELS = (
    "hypotheses/test_voting",
    "selection/test_bodies",
    "verification/test_descent",
    "verification/test_verification_kernels",
    "model/test_thinning",
)
OUT_OF_BOUNDS = """
import numpy as np
from numba import njit

@njit
def read(values, k):
    return values[k]

read(np.zeros(3), 3)
"""


def kernel_files() -> set[Path]:
    """Return the files of the kernels, and of the package those that they import, directly or not."""
    found: set[Path] = set()
    left = list((ROOT / "perception").rglob("_*kernels.py"))
    while left:
        path = left.pop()
        if path not in found:
            found.add(path)
            modules = re.findall(r"^from (perception[\w.]*) import", path.read_text(), flags=re.MULTILINE)
            left += [ROOT / f"{module.replace('.', '/')}.py" for module in modules]
    return found


@pytest.fixture
def checked() -> dict[str, str]:
    """Return an environment with the check on.

    Numba's own cache does not tell checked code from unchecked, nor does it see a change in another file, of a kernel
    or a constant: checked code has a folder of its own for each state of the kernels and of what they import.
    """
    sources = [(str(path), path.read_text()) for path in sorted(kernel_files())]
    assert len(sources) > 15
    folder = cache_folder() / f"checked-kernels-{digest(numba.__version__, *sources)}"
    return {**os.environ, "NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(folder)}


def test_every_compiled_function_is_in_a_file_of_kernels() -> None:
    """By its name, or as a constant or function that one of them imports."""
    files = kernel_files()
    assert ROOT / "perception" / "geometry.py" in files  # by an import
    compiled = [path for path in (ROOT / "perception").rglob("*.py") if "njit" in path.read_text()]
    assert set(compiled) <= files


@pytest.mark.slow
def test_the_check_sees_an_index_out_of_bounds(checked: dict[str, str]) -> None:
    done = subprocess.run([sys.executable, "-c", OUT_OF_BOUNDS], env=checked, capture_output=True, text=True)
    assert done.returncode != 0
    assert "IndexError" in done.stderr


@pytest.mark.slow
def test_the_kernels_pass_their_tests_with_every_index_checked(checked: dict[str, str]) -> None:
    files = [str(POSE_TESTS / f"{name}.py") for name in KERNELS]
    options = ["-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", "-m", "not slow"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, *files], env=checked, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
