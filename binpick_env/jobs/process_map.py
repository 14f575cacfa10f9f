"""Map a pure function over indices: in this process, in several worker processes of this machine, or on a cluster."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

import cv2

from binpick_env.jobs.workers import Cluster, Workers
from binpick_env.jobs.workers import WorkerError as WorkerError
from perception.runtime.file_work import FolderWork as FolderWork
from perception.runtime.file_work import InputWork as InputWork
from perception.runtime.file_work import without_inputs
from perception.runtime.threads import one_core

Result = TypeVar("Result")


def map_indices(
    work: Callable[[int], Result],
    indices: Sequence[int],
    workers: Workers,
    initializer: Callable[..., None] | None = None,
    initargs: tuple[Any, ...] = (),
) -> Iterator[Result]:
    """Yield ``work(index)`` for every index in order of completion; each worker computes on one core.

    The results are the same wherever they are computed. Work that writes files must be a :class:`FolderWork`, or they
    stay on the node of a cluster. Work that reads large files must be an :class:`InputWork`, or every node gets all of
    them.

    Args:
        work: Function of an index. It must be picklable; worker processes share no state with this one.
        indices: Indices to compute.
        workers: Number of worker processes, or a cluster. With 1 the work is done in this process, in the order of the
            indices.
        initializer: Function that each new worker process calls once.
        initargs: Arguments of the initializer.

    Raises:
        ValueError: ``workers`` is not positive.
        WorkerError: A worker process was killed; the results yielded before remain valid. A cluster computes the index
            again; see :func:`binpick_env.jobs.ray_map.map_on_cluster` for its own errors.
    """
    if isinstance(workers, Cluster):
        from binpick_env.jobs.ray_map import map_on_cluster

        yield from map_on_cluster(work, indices, workers, initializer, initargs)
        return
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    work, _ = without_inputs(work)  # which are here
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
                child.terminate()  # results are written atomically: only unfinished work is lost
            raise
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


def _start_worker(initializer: Callable[..., None] | None, initargs: tuple[Any, ...]) -> None:
    """Ignore Ctrl-C, which reaches every process of the terminal and is the parent's to handle; compute on one core."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    cv2.setNumThreads(1)
    if initializer is not None:
        initializer(*initargs)


def _end_with_parent() -> None:
    """Wait for the parent to end, then exit: a parent that is killed cannot stop its workers."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
