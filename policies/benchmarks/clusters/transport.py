"""What results cost the process that starts a job on a Ray cluster: for each, and for each megabyte."""

import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from binpick_env.jobs.process_map import map_indices
from binpick_env.jobs.workers import Workers
from perception.runtime.file_work import FolderWork
from policies.benchmarks.measurement import Measurement

START, ITEM, MEGABYTE = "start of a worker", "taking an item", "taking a megabyte"
_SMALL, _LARGE = 0.001, 1.0  # sizes of results that are compared [MB]


def measure_transport(cluster: Workers, items: int, repeats: int) -> Iterator[Measurement]:
    """Measure with items that do nothing but write a file; each row is yielded as it is measured.

    Processor time is measured, that of all threads of this process, which may compute in parallel.

    Args:
        cluster: Cluster to measure; one of this machine has the same costs, but no network.
        items: Number of items of a repeat.
        repeats: Number of repeats.

    Raises:
        ValueError: A number is not positive.
        WorkerError: The cluster cannot be joined.
    """
    if items < 1 or repeats < 1:
        raise ValueError(f"items and repeats must be at least 1, got {items} and {repeats}")
    begun = time.perf_counter()
    _taken(cluster, _SMALL, 1)
    yield Measurement(name=START, unit="s", values=(time.perf_counter() - begun,))
    small = [_taken(cluster, _SMALL, items) for _ in range(repeats)]
    yield Measurement(name=ITEM, unit="ms", values=tuple(1000 * each for each in small))
    large = [_taken(cluster, _LARGE, items) for _ in range(repeats)]
    per_megabyte = [max(b - a, 0.0) / (_LARGE - _SMALL) for a, b in zip(small, large, strict=True)]
    yield Measurement(name=MEGABYTE, unit="ms", values=tuple(1000 * each for each in per_megabyte))


def _taken(cluster: Workers, megabytes: float, items: int) -> float:
    """Return the processor time of this process for an item [s]."""
    with tempfile.TemporaryDirectory() as folder:
        work = FolderWork(partial(_write, round(1e6 * megabytes)), Path(folder))
        begun = time.process_time()
        for _ in map_indices(work, range(items), cluster):
            pass
        return (time.process_time() - begun) / items


def _write(size: int, folder: Path, index: int) -> int:
    (folder / f"{index}.bin").write_bytes(bytes(size))
    return index
