"""Map work over the nodes of a Ray cluster."""

import uuid
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from binpick_env.jobs.build import build
from binpick_env.jobs.cluster_job import Job, Outcome, SentFile
from binpick_env.jobs.ray_cluster import ATTEMPTS, GIVEN_UP, Nodes, answer, join, variables
from binpick_env.jobs.workers import Cluster, WorkerError
from perception.runtime.file_work import FolderWork, without_inputs

Result = TypeVar("Result")


def submitted(cores: int) -> int:
    """Return how many indices are submitted at a time: every core stays busy, and a cluster sees that it may grow."""
    return 2 * cores + 4


def map_on_cluster(
    work: Callable[[int], Result],
    indices: Sequence[int],
    cluster: Cluster,
    initializer: Callable[..., None] | None = None,
    initargs: tuple[Any, ...] = (),
) -> Iterator[Result]:
    """Yield ``work(index)`` for every index in order of completion, each computed on one core of a node.

    An index whose worker or node is lost is computed again. The files of a :class:`FolderWork` are in its folder when
    its result is yielded.

    Args:
        work: Function of an index; it must be picklable. Files that it names by a path or a text travel with it, once
            to each node, and those of an :class:`InputWork` with the index that reads them. The latter are in memory
            for no more indices than are submitted at a time.
        indices: Indices to compute.
        cluster: Where they are computed.
        initializer: Function that each worker process calls once.
        initargs: Arguments of the initializer.

    Raises:
        WorkerError: Ray is not installed, the cluster cannot be joined or is lost, a node runs another build of the
            project, or the workers of an index were killed again and again. The results yielded before remain valid.
    """
    if not indices:
        return
    work, inputs = without_inputs(work)
    ray, sent_apart = join(cluster), (path for paths in inputs.values() for path in paths)
    started = _Started(ray, Job.of(work, initializer, initargs, sent_apart), inputs)  # no name keeps the job
    todo, lost = deque(indices), Counter[int]()
    try:
        while todo or started.indices:
            while todo and started.has_room():
                started.submit(todo.popleft())
            for index, outcome in started.finished():
                if outcome is None:  # its worker is lost
                    lost[index] += 1
                    if lost[index] == ATTEMPTS:
                        raise WorkerError(GIVEN_UP.format(what=f"index {index}", attempts=ATTEMPTS))
                    todo.append(index)
                    continue
                if isinstance(work, FolderWork):
                    work.keep(outcome.files)
                yield outcome.result
    finally:
        started.cancel()


class _Started:
    """The indices that are being computed, and the nodes that do it."""

    def __init__(self, ray: Any, job: Job, inputs: Mapping[int, Sequence[Path]]) -> None:
        self.nodes = Nodes(ray)
        self.indices: dict[Any, int] = {}  # by the references of their outcomes
        self._ray = ray
        self._inputs = inputs
        self._arguments = (uuid.uuid4().hex, dict(build()), [ray.put(job)])  # in a list, it is fetched when asked for
        options = {"num_cpus": 1, "max_retries": 0, "runtime_env": {"env_vars": variables()}}
        self._task = ray.remote(_task()).options(**options)

    def has_room(self) -> bool:
        """Tell whether more indices should be submitted."""
        return len(self.indices) < submitted(self.nodes.cores)

    def submit(self, index: int) -> None:
        """Let a node compute an index when one of its cores is free."""
        files = [self._ray.put(SentFile.read(path)) for path in self._inputs.get(index, ())]
        self.indices[self._task.remote(*self._arguments, index, files)] = index

    def finished(self) -> Iterator[tuple[int, Outcome | None]]:
        """Yield each index that is computed, with None if its worker or node was lost; none if it takes long.

        Raises:
            WorkerError: The cluster is lost, or a node is unsuitable. What the work raises is raised unchanged.
        """
        for reference in self.nodes.wait(self.indices):
            yield self.indices.pop(reference), answer(self._ray, reference)

    def cancel(self) -> None:
        """Stop what is being computed: files are written here, and atomically, so only unfinished work is lost."""
        for reference in self.indices:
            with suppress(Exception):  # of a cluster that is lost
                self._ray.cancel(reference, force=True)
        self.nodes.leave()


def _task() -> Callable[..., bytes]:
    """Return the function of a task, which is pickled by value: a node without the project can say so."""

    def compute_index(key: str, required: dict[str, str], job: list[Any], index: int, inputs: list[Any]) -> bytes:
        import ray
        from cloudpickle import dumps

        from binpick_env.jobs.node import compute

        outcome = compute(key, required, lambda: ray.get(job[0]), index, lambda: ray.get(inputs))
        return dumps(outcome)  # type: ignore[no-any-return]

    return compute_index
