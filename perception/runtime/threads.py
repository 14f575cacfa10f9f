"""Number of threads of a computation, so that measured times can be compared."""

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
    """Compute on one thread within this context, and in processes that it starts.

    The setting of OpenCV takes effect at once. BLAS and OpenMP read their environment variables when they are loaded,
    so these take effect in new processes only. The compiled kernels are not parallel, and MuJoCo steps on one thread.
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
    """Let OpenCV, and torch if it is loaded, compute on ``count`` threads within this context; None changes nothing.

    Raises:
        ValueError: ``count`` is not positive.
    """
    if count is None:
        yield
        return
    if count < 1:
        raise ValueError(f"threads must be at least 1, got {count}")
    torch = sys.modules.get("torch")  # a computation without a network need not load it
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
    """Return the results of ``work`` for each item, in order, computed on as many threads as OpenCV may use.

    Threads save time only where ``work`` runs compiled code that releases the interpreter's lock.
    """
    todo, threads = list(items), cv2.getNumThreads()
    if min(len(todo), threads) < 2:
        return [work(item) for item in todo]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, todo))
