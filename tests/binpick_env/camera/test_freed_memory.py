"""Memory that the process keeps between frames; counted in a process of its own, whose allocator nothing has set."""

import os
import platform
import subprocess
import sys

import pytest

# Page faults of ten frames' arrays: 40 MB that are freed together.
FRAMES = """
import resource, sys
import numpy as np
from binpick_env.camera.freed_memory import keep_freed_memory

def frame():
    return [np.ones(5_000_000, np.uint8) for _ in range(8)]

np.empty(15_000_000, np.uint8)  # what any frame frees
if sys.argv[1] == "keep":
    keep_freed_memory()
frame()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(10):
    frame()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc adapts to what is freed")
def test_arrays_of_the_next_frame_need_no_fresh_pages() -> None:
    env = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "GLIBC_"))}
    faults = {
        how: int(subprocess.run([sys.executable, "-c", FRAMES, how], env=env, capture_output=True, check=True).stdout)
        for how in ("keep", "default")
    }
    assert faults["keep"] * 4 < faults["default"]
