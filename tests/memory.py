"""Memory that a test process holds, and gives back to the system."""

import ctypes
import gc
import os
import sys
from pathlib import Path

GROWTH = 100e6  # growth of the process since memory was last given back, from which more is given back [bytes]
_RESIDENT = Path("/proc/self/statm")
_kept = 0.0


def give_back() -> None:
    """Free what nothing uses any more, if the process has grown.

    A cell of 250 MB is made of few objects, so that the garbage collector does not start by itself.
    """
    global _kept
    if _resident() > _kept + GROWTH:
        gc.collect()
        if sys.platform == "linux":
            ctypes.CDLL(None).malloc_trim(0)
        _kept = _resident()


def _resident() -> float:
    """Return the bytes of memory that this process occupies, 0 where the system does not tell."""
    return float(_RESIDENT.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if _RESIDENT.exists() else 0.0
