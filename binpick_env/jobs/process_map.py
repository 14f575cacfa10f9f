"""A map of a pure function over indices: in this process, or in many of this machine's."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

import cv2

from perception.runtime.threads import one_core

Result = TypeVar("Result")


class WorkerError(RuntimeError):
    """A worker process was killed."""


def map_indices(
    work: Callable[[int], Result],
    indices: Sequence[int],
    workers: int,
    initializer: Callable[..., None] | None = None,
    initargs: tuple[Any, ...] = (),
) -> Iterator[Result]:
    """Yield ``work(index)`` for every index, as they are finished; each worker computes on one core.

    Args:
        work: Picklable; every process starts with an empty memory.
        indices: Any order.
        workers: Processes; 1 computes in this one, in order.
        initializer: Called once in each new process.
        initargs: Its arguments.

    Raises:
        ValueError: ``workers`` is not positive.
        WorkerError: A process was killed; what was yielded stays.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    if workers < 2 or len(indices) < 2:
        for index in indices:
            with one_core():
                result = work(index)
            yield result
        return
    before = set(multiprocessing.active_children())
    with one_core():
        executor = ProcessPoolExecutor(
            min(workers, len(indices)),
            mp_context=multiprocessing.get_context("spawn"),
            initializer=_start_worker,
            initargs=(initializer, initargs),
        )
        try:
            futures = [executor.submit(work, index) for index in indices]
            for future in as_completed(futures):
                yield future.result()
        except BrokenProcessPool as error:
            raise WorkerError("a worker was killed, perhaps for want of memory; try fewer workers") from error
        except (KeyboardInterrupt, GeneratorExit):
            for child in set(multiprocessing.active_children()) - before:
                child.terminate()  # files are whole or absent: nothing but the work under way is lost
            raise
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


def _start_worker(initializer: Callable[..., None] | None, initargs: tuple[Any, ...]) -> None:
    """Leave Ctrl-C, which reaches every process of the terminal, to the parent; compute on one core."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    cv2.setNumThreads(1)
    if initializer is not None:
        initializer(*initargs)


def _end_with_parent() -> None:
    """Wait for the parent's end, and do not outlive it: a parent that is killed tells its workers nothing."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
