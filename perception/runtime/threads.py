"""Number of threads of a computation, so that measured times can be compared."""

import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from numbers import Integral
from typing import Any, TypeVar

import cv2

Item = TypeVar("Item")
Result = TypeVar("Result")

# They are read by OpenMP, BLAS and numba when these are loaded.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@contextmanager
def one_core() -> Iterator[None]:
    """Compute on one thread within this context, and in processes that it starts.

    The setting of OpenCV takes effect at once. BLAS and OpenMP read their environment variables when they are loaded,
    so these take effect in new processes only. The compiled kernels are not parallel, and MuJoCo steps on one thread.
    """
    kept = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    threads = cv2.getNumThreads()
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
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

    Several threads may be in such contexts at once: OpenCV then takes the smallest of their numbers, and what was set
    before the first one entered returns when the last one leaves.

    Raises:
        ValueError: ``count`` is no positive whole number.

    Note:
        Numba sets torch back to all cores when its own threads are first asked for. Where torch is loaded on entry,
        numba is kept from it.
    """
    if count is None:
        yield
        return
    if not isinstance(count, Integral) or count < 1:
        raise ValueError(f"threads must be a whole number, at least 1, got {count!r}")
    _SETTING.enter(count)
    try:
        yield
    finally:
        _SETTING.leave()


def default_threads() -> int:
    """Return the number of threads of perception where none is given: that of :func:`use_threads` around it, else 1.

    One thread each is several times faster than all cores for all where several processes compute at once.
    """
    return _SETTING.count() or 1


class _Setting:
    """The numbers of threads that contexts have set, of each thread of this process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts: dict[int, list[int]] = {}  # of each thread in a context, the innermost last
        self._opencv = 1  # before the first context
        self._torch: int | None = None  # before the first context; None until torch is loaded

    def count(self) -> int | None:
        """Return the number of this thread's innermost context, None outside of any."""
        counts = self._counts.get(threading.get_ident())
        return counts[-1] if counts else None

    def enter(self, count: int) -> None:
        torch = _loaded_torch()
        with self._lock:
            if not self._counts:
                self._opencv, self._torch = cv2.getNumThreads(), None
            if torch and self._torch is None:
                self._torch = torch.get_num_threads()
            self._counts.setdefault(threading.get_ident(), []).append(count)
            self._apply(torch)

    def leave(self) -> None:
        torch = _loaded_torch()
        with self._lock:
            counts = self._counts[threading.get_ident()]
            counts.pop()
            if not counts:
                del self._counts[threading.get_ident()]
            self._apply(torch)

    def _apply(self, torch: Any) -> None:
        """Set the libraries; torch holds a number for each thread, and one for what all of them share."""
        least = min((counts[-1] for counts in self._counts.values()), default=None)
        cv2.setNumThreads(least or self._opencv)
        own = self.count() or self._torch
        if torch and own is not None:
            torch.get_num_threads()  # a thread's first call takes over what is shared, now and not after the next line
            torch.set_num_threads(own)
            if least is not None and least != own:  # what is shared goes by the last call, whichever thread's it is
                shared = threading.Thread(target=torch.set_num_threads, args=(least,))
                shared.start()
                shared.join()


_SETTING = _Setting()


def _loaded_torch() -> Any:
    """Return torch, which numba leaves alone from now on, or None: a computation without a network need not load it."""
    torch = sys.modules.get("torch")
    if not hasattr(torch, "set_num_threads"):  # another thread may be loading it
        return None
    _keep_from_numba(torch)
    return torch


def _keep_from_numba(torch: Any) -> None:
    """Let numba start its threads without a change of torch's number.

    Numba starts them when they are first asked for, by ``numba.get_num_threads`` or by a parallel kernel, and sets the
    number of OpenMP's threads to all cores, which is torch's number, too. Starting them early instead would end forked
    processes that run parallel kernels.
    """
    from numba.np.ufunc import parallel  # numba takes long to load, as torch does

    start: Callable[[], None] = parallel._launch_threads
    if getattr(start, "keeps_torch", False):
        return

    def start_and_keep() -> None:
        before = torch.get_num_threads()
        start()
        if torch.get_num_threads() != before:
            torch.set_num_threads(before)

    start_and_keep.keeps_torch = True  # type: ignore[attr-defined]
    parallel._launch_threads = start_and_keep


def in_threads(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return the results of ``work`` for each item, in order, computed on as many threads as OpenCV may use.

    Threads save time only where ``work`` runs compiled code that releases the interpreter's lock.
    """
    todo, threads = list(items), cv2.getNumThreads()
    if min(len(todo), threads) < 2:
        return [work(item) for item in todo]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, todo))
