"""How many threads compute: one core means one core, so that times can be compared."""

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import cv2

Item = TypeVar("Item")
Result = TypeVar("Result")

_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@contextmanager
def one_core() -> Iterator[None]:
    """Compute on one thread in here, and in processes started in here; afterwards all is as before.

    OpenCV is told so at once; BLAS and OpenMP read their variables when they are loaded, so those reach new processes
    only. The compiled kernels are not parallel, and MuJoCo steps on one thread.
    """
    kept = {name: os.environ.get(name) for name in _VARIABLES}
    threads = cv2.getNumThreads()
    os.environ.update(dict.fromkeys(_VARIABLES, "1"))
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
        for name, value in kept.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def use_threads(count: int | None) -> Iterator[None]:
    """Let OpenCV, and torch if it is loaded by now, compute on ``count`` threads in here; None leaves them alone.

    Raises:
        ValueError: ``count`` is not positive.
    """
    if count is None:
        yield
        return
    if count < 1:
        raise ValueError(f"threads must be at least 1, got {count}")
    torch = sys.modules.get("torch")  # what does without a network need not load it
    before = cv2.getNumThreads(), torch.get_num_threads() if torch else 0
    cv2.setNumThreads(count)
    if torch:
        torch.set_num_threads(count)
    try:
        yield
    finally:
        cv2.setNumThreads(before[0])
        if torch:
            torch.set_num_threads(before[1])


def in_threads(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return ``work`` done on each item, in their order, on as many threads as OpenCV may use.

    It pays where ``work`` spends its time in compiled code that lets go of the interpreter's lock.
    """
    todo, threads = list(items), cv2.getNumThreads()
    if min(len(todo), threads) < 2:
        return [work(item) for item in todo]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, todo))
