"""Each test process computes on one thread, since pytest-xdist starts one a core, and gives back what cells held."""

import gc
import os
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

# Read by OpenMP, BLAS and numba when they are loaded, and by the processes that tests start.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import cv2  # noqa: E402

from perception.runtime.cache import digest  # noqa: E402
from tests.chromium import chromium  # noqa: E402
from tests.memory import end_file, give_back, release_large_blocks  # noqa: E402

cv2.setNumThreads(1)
release_large_blocks()

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("perception", "binpick_env", "policies")
COMPILED = "binpick/kernels"  # digest of the kernels that an earlier session compiled, in pytest's cache
# Files whose tests hold several cells at once, the longest first.
LARGE = (
    "tests/test_shell_lines.py",
    "tests/policies/selection/test_env.py",
    "tests/binpick_env/observation/test_pixel_perceiver.py",
    "tests/policies/assessment/test_run.py",
    "tests/policies/picking/test_fast_execution.py",
    "tests/test_examples.py",
    "tests/policies/commands/test_pick.py",
    "tests/policies/commands/test_bench.py",
    "tests/binpick_env/test_snapshot.py",
)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the kernels once, in a process that ends, before several test processes load them."""
    config = session.config
    if not getattr(config.option, "numprocesses", None) or hasattr(config, "workerinput"):
        return
    sources = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("_*kernels.py"))]
    kernels = digest(version("numba"), *((str(path), path.read_text(encoding="utf-8")) for path in sources))
    cache = getattr(config, "cache", None)
    if cache is not None and cache.get(COMPILED, None) == kernels:
        return
    config.get_terminal_writer().line("compiling the kernels, unless it is done: up to a minute")
    done = subprocess.run([sys.executable, "-m", "tests.compiled_kernels"], cwd=ROOT, capture_output=True, check=False)
    if cache is not None and done.returncode == 0:
        cache.set(COMPILED, kernels)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the files with slow tests first, so that no process is left with one of them at the end.

    Of these the large ones come first, while the processes are small.
    """
    large = {ROOT / name: place for place, name in enumerate(LARGE)}
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: (large.get(item.path, len(large)), item.path not in slow))


def pytest_collection_finish() -> None:
    """Leave what imports made, a million objects, out of every later garbage collection."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    """Give memory back when the fixtures of a test are gone; at the end of its file also what caches hold."""
    result = yield
    if nextitem is None or nextitem.path != item.path:
        end_file()
    else:
        give_back()
    return result


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as started:
        yield started
