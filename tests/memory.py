"""Memory that a test process holds, and gives back to the system."""

import ctypes
import gc
import os
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

GROWTH = 50e6  # growth of the process since memory was last given back, from which more is given back [bytes]
FILE_GROWTH = 25e6  # the same at the end of a file of tests, when the cells that its tests shared are gone
AMPLE = 900e6  # size of the process up to which caches are kept and freed memory is left for the next cell [bytes]
_MMAP_THRESHOLD = -3  # M_MMAP_THRESHOLD of mallopt(3)
_RESIDENT = Path("/proc/self/statm")
# Caches of cells, of networks and of parts with their tables, by module. Those that hold a few numbers stay.
CACHES = {
    "binpick_env.evaluation.noise.bins": ("_cells",),
    "binpick_env.evaluation.pose.method": ("_loaded",),
    "binpick_env.evaluation.segmentation.method": ("_loaded",),
    "binpick_env.scenes.synthesis": ("_scene_setup",),
    "perception.s3dis.predictor": ("_network",),
    "policies.report.pick_picture": ("part_edges",),
    "policies.selection.learning.experience": ("_environments",),
    "tests.binpick_env.evaluation.pose.test_evaluation": ("captured_scene",),
    "tests.binpick_env.evaluation.segmentation.test_evaluation": ("captured_scene",),
    "tests.perception.bin.box_scene": ("_seen",),
    "tests.perception.diagnosis.bin_scene": ("good",),
}
FORGETTABLE: list[dict[Any, Any]] = []  # caches of the tests that are emptied with them
_kept = 0.0
_kept_of_files = 0.0


def give_back() -> None:
    """Free what nothing uses any more, if the process has grown; also what caches hold, if it is not small.

    A cell of 250 MB is made of few objects, so that the garbage collector does not start by itself. It takes a tenth
    of a second, and is left alone where the memory of cells that went is enough.
    """
    global _kept
    if _resident() > _kept + GROWTH:
        _trim()
        if _resident() > _kept + GROWTH:
            if _resident() > AMPLE:
                _empty_caches()
            gc.collect()
            _trim()
        _kept = _resident()


def end_file() -> None:
    """Free what the tests of a file left behind, also what caches hold, if the process is not small and has grown."""
    global _kept, _kept_of_files
    if _resident() > max(AMPLE, _kept_of_files + FILE_GROWTH):
        _empty_caches()
        gc.collect()
        _trim()
        _kept = _kept_of_files = _resident()


def trimmed_after(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function after which a process that is not small gives back what malloc has free.

    The spec of a cell, 90 MB in small pieces, would otherwise stay beside what is made next.
    """

    @wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        result = function(*arguments, **named)
        if _resident() > AMPLE:
            _trim()
        return result

    return call


def _empty_caches() -> None:
    for module, names in CACHES.items():
        for name in names:
            cache = getattr(sys.modules.get(module), name, None)
            for method in ("cache_clear", "clear"):
                if hasattr(cache, method):  # a test may have put something else there
                    getattr(cache, method)()
    for results in FORGETTABLE:
        results.clear()


def release_large_blocks() -> None:
    """Have malloc take every block of at least 1 MB from the system, and return it as soon as it is freed.

    Its own threshold rises to 32 MB with the first large block that is freed. Large arrays then lie between small ones,
    and hundreds of megabytes that are free can be given back by no trim.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, 1 << 20)


def _trim() -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).malloc_trim(0)


def _resident() -> float:
    """Return the bytes of memory that this process occupies, 0 where the system does not tell."""
    return float(_RESIDENT.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if _RESIDENT.exists() else 0.0
