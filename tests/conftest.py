"""Each test process computes on one thread, since pytest-xdist starts one a core, and gives back what cells held."""

import ctypes
import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

# Read by OpenMP, BLAS and numba when they are loaded, and by the processes that tests start.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import cv2  # noqa: E402

from tests.chromium import chromium  # noqa: E402

cv2.setNumThreads(1)

GROWTH = 100e6  # of this process since its memory was last given back [bytes]
_RESIDENT = Path("/proc/self/statm")
_kept = 0.0


def _resident() -> float:
    """Return the bytes of memory that this process occupies, 0 where the system does not tell."""
    return float(_RESIDENT.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if _RESIDENT.exists() else 0.0


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the files with slow tests first, so that no process is left with one of them at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


def pytest_collection_finish() -> None:
    """Leave what imports made, a million objects, out of every later garbage collection."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def _memory_is_given_back() -> Iterator[None]:
    """Free cells that tests leave behind: each holds 250 MB in cycles, too few objects for the collector to notice."""
    global _kept
    yield
    if _resident() > _kept + GROWTH:
        gc.collect()
        if sys.platform == "linux":
            ctypes.CDLL(None).malloc_trim(0)
        _kept = _resident()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as started:
        yield started
