"""What a test process lets go of is still where it is looked for."""

import importlib
import subprocess
import sys
from functools import lru_cache

import pytest

from tests import conftest, memory
from tests.shared_models import remembered

ARRAYS = """
import numpy as np
from tests import memory

memory.release_large_blocks()
np.ones(3_000_000)  # malloc would take the size of what is freed for its threshold
before = memory._resident()
large, small = [], []
for _ in range(50):
    large.append(np.ones(250_000))
    small.append(np.ones(1000))
held = memory._resident() - before
large.clear()
print(held, memory._resident() - before)
"""


@pytest.mark.parametrize("module", memory.CACHES)
def test_caches_that_are_emptied_are_there(module: str) -> None:
    for name in memory.CACHES[module]:
        cache = getattr(importlib.import_module(module), name)
        assert hasattr(cache, "cache_clear") or isinstance(cache, dict), name


def test_large_files_are_there() -> None:
    assert all((conftest.ROOT / name).is_file() for name in conftest.LARGE)


@pytest.mark.parametrize("large", [True, False])
def test_a_process_that_is_not_small_forgets(monkeypatch: pytest.MonkeyPatch, large: bool) -> None:
    monkeypatch.setattr(memory, "CACHES", {__name__: ("_squared",)})
    monkeypatch.setattr(memory, "_kept_of_files", 0.0)
    monkeypatch.setattr(memory, "AMPLE", 0.0 if large else 1e15)
    calls: list[int] = []
    remember = remembered(calls.append, forgettable=True)
    for _ in range(2):
        remember(3)
        _squared(3)
    memory.end_file()
    remember(3)
    assert calls == [3, 3] if large else [3]
    assert _squared.cache_info().currsize == (0 if large else 1)


@pytest.mark.skipif(sys.platform != "linux", reason="the resident size is read from /proc")
def test_large_arrays_between_small_ones_go_back_to_the_system() -> None:
    """In a process of its own: a large one has free memory that takes them in."""
    done = subprocess.run([sys.executable, "-c", ARRAYS], cwd=conftest.ROOT, capture_output=True, text=True, check=True)
    held, left = (float(number) for number in done.stdout.split())
    assert held > 80e6
    assert left < 20e6


@lru_cache
def _squared(number: int) -> int:
    return number**2
