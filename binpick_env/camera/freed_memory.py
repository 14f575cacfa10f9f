"""Keeps freed memory in the process, so that the next frame's arrays need no fresh pages."""

from functools import cache

import numpy as np

_LARGEST = 31 * 2**20  # size of a block [bytes]; glibc adapts to blocks of up to 32 MiB


@cache
def keep_freed_memory() -> None:
    """Let the C library keep up to 62 MiB of freed memory, once for a process.

    A frame's arrays are 70 MB together. Freed and allocated again, their pages are cleared by the system each time,
    which takes longer than any single stage of the camera. glibc keeps up to twice the size of the largest block that
    was freed; so one block is freed, whose pages are never touched. Other C libraries are not affected, nor is a
    process whose thresholds were set by ``mallopt`` or the environment.
    """
    np.empty(_LARGEST, np.uint8)
