"""How much memory the resets of one environment add."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from binpick_env.config import Perception
from binpick_env.env import BinPickEnv

WARM_UP = 0.2  # share of the resets that are left out of the fit: caches and pools fill first


@dataclass(frozen=True, kw_only=True)
class MemorySettings:
    """Resets of one environment whose memory is measured.

    Attributes:
        resets: Number of resets.
        part: Name of the part.
        num_parts: Smallest and largest number of parts in a pile.
        perception: What finds the parts in a frame.
    """

    resets: int = 1000
    part: str = "tee"
    num_parts: tuple[int, int] = (3, 6)
    perception: Perception = "learned"

    def __post_init__(self) -> None:
        if self.resets < 5:
            raise ValueError(f"resets must be at least 5, to fit a line, got {self.resets}")


def growth_in_child(settings: MemorySettings) -> float:
    """Return the growth of a fresh process in memory [MB for each 100 resets]."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as executor:
        return executor.submit(growth, settings).result()


def growth(settings: MemorySettings) -> float:
    """Return the slope of a line fitted to this process's memory over the resets [MB for each 100 resets]."""
    env = BinPickEnv(
        part=settings.part,
        num_parts=settings.num_parts,
        perception=settings.perception,
        threads=1,
        width=640,
        height=480,
    )
    used = []
    for k in range(settings.resets):
        env.reset(seed=k)
        used.append(resident_mb())
    env.close()
    first = round(WARM_UP * settings.resets)
    slope, _ = np.polyfit(np.arange(first, settings.resets), used[first:], 1)
    return 100 * float(slope)


def resident_mb() -> float:
    """Return the resident memory of this process [MB]."""
    (line,) = [
        line for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines() if line.startswith("VmRSS:")
    ]
    return int(line.split()[1]) / 1024
