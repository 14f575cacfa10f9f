"""Objects on the nodes of a Ray cluster, whose methods are called from this process."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

from binpick_env.jobs.build import build
from binpick_env.jobs.cluster_job import Job, Outcome
from binpick_env.jobs.ray_cluster import Nodes, answer, join, variables
from binpick_env.jobs.workers import Cluster, WorkerError


class ClusterObjects:
    """Objects on a cluster, each in a worker process of its own on one core.

    Unlike the indices of a map they keep what they remember from call to call. An object whose worker is lost is gone:
    the next call makes it anew, on any node, and whoever calls has to tell it what it has to know.

    Args:
        make: Makes the object of an index; it must be picklable. Files that it names travel with it, as those of
            :func:`binpick_env.jobs.ray_map.map_on_cluster` do.
        count: Number of objects.
        cluster: Where they are.

    Raises:
        WorkerError: Ray is not installed, the cluster cannot be joined, or it has too few cores.
    """

    def __init__(self, make: Callable[[int], Any], count: int, cluster: Cluster) -> None:
        self._ray = join(cluster)
        self._nodes = Nodes(self._ray, needed=count)
        if self._nodes.cores < count:
            self._nodes.leave()
            raise WorkerError(f"the cluster has {self._nodes.cores} cores: ask for as many workers, not {count}")
        job = self._ray.put(Job.of(make, None, ()))
        self._arguments = (dict(build()), [job])  # in a list, it is fetched when asked for
        options = {"num_cpus": 1, "max_restarts": 0, "runtime_env": {"env_vars": variables()}}
        self._kind = self._ray.remote(_kind()).options(**options)
        self._workers: dict[int, Any] = {}  # by the indices of their objects
        self._calls: dict[Any, int] = {}  # indices by the references of outcomes

    def call(self, index: int, method: str, *arguments: Any) -> None:
        """Let the object of an index, which is made if it is not there, call a method."""
        if index not in self._workers:
            self._workers[index] = self._kind.remote(*self._arguments, index)
        self._calls[self._workers[index].call.remote(method, arguments)] = index

    def finished(self) -> Iterator[tuple[int, Outcome | None]]:
        """Yield the index and outcome of calls that are done, None if the object was lost; none if it takes long.

        Raises:
            WorkerError: The cluster is lost or has too few cores left, or a node is unsuitable. What a method raises is
                raised unchanged.
        """
        for reference in self._nodes.wait(self._calls):
            index, outcome = self._calls.pop(reference), answer(self._ray, reference)
            if outcome is None:
                self._end(index)
            yield index, outcome

    def close(self) -> None:
        """End the workers."""
        for index in list(self._workers):
            self._end(index)
        self._nodes.leave()

    def _end(self, index: int) -> None:
        worker = self._workers.pop(index)
        with suppress(Exception):  # of a cluster that is lost
            self._ray.kill(worker)


def _kind() -> type:
    """Return the class of a worker, which is pickled by value: a node without the project can say so."""

    class Worker:
        def __init__(self, required: dict[str, str], job: list[Any], index: int) -> None:
            self._arguments = (required, job, index)
            self._object: Any = None

        def call(self, method: str, arguments: tuple[Any, ...]) -> bytes:
            import ray
            from cloudpickle import dumps

            from binpick_env.jobs.node import NodeObject

            if self._object is None:  # an error in a constructor would not arrive as it is
                required, job, index = self._arguments
                self._object = NodeObject(required, lambda: ray.get(job[0]), index)
            return dumps(self._object.call(method, arguments))  # type: ignore[no-any-return]

    return Worker
