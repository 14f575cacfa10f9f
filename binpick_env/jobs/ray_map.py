"""Map work over the nodes of a Ray cluster. Ray is imported only where a cluster is asked for."""

import os
import pickle
import socket
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from binpick_env.jobs.build import build
from binpick_env.jobs.cluster_job import Job, Outcome, SentFile
from binpick_env.jobs.workers import LOCAL, Cluster, WorkerError
from perception.runtime.file_work import FolderWork, without_inputs
from perception.runtime.provenance import COMMAND, COMMIT, command_line, git_commit
from perception.runtime.threads import THREAD_VARIABLES

Result = TypeVar("Result")
ATTEMPTS = 4  # number of workers that are lost over an index before it is given up
_REFRESH = 2.0  # time after which nodes are counted again [s]
_PATIENCE = 30.0  # time without a head node, or without a node that computes, after which the cluster is lost [s]
_STORE = 512 * 1024**2  # memory for results on their way in a cluster of this machine [bytes]
_PASSED_ON = ("MUJOCO_GL", "PYOPENGL_PLATFORM")  # variables that choose what draws pictures
_GIVEN_UP = (
    "index {index} was given up, since {attempts} workers were lost over it, perhaps for want of memory: try fewer "
    "workers, that is fewer CPUs on each node (ray start --num-cpus)"
)
_HELP = "see docs/howto/cluster.md, and `ray status` on the head node"

_joined: Cluster | None = None  # the cluster that this process has joined
_nodes = 0  # number of nodes that compute


def nodes_in_use() -> int:
    """Return the number of nodes that compute for this process, 0 without a cluster."""
    return _nodes


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
    ray, sent_apart = _join(cluster), (path for paths in inputs.values() for path in paths)
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
                        raise WorkerError(_GIVEN_UP.format(index=index, attempts=ATTEMPTS))
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
        variables = dict.fromkeys(THREAD_VARIABLES, "1") | {COMMIT: git_commit(), COMMAND: command_line()}
        variables |= {name: os.environ[name] for name in _PASSED_ON if name in os.environ}
        self.nodes = _Nodes(ray)
        self.indices: dict[Any, int] = {}  # by the references of their outcomes
        self._ray = ray
        self._inputs = inputs
        self._arguments = (uuid.uuid4().hex, dict(build()), [ray.put(job)])  # in a list, it is fetched when asked for
        options = {"num_cpus": 1, "max_retries": 0, "runtime_env": {"env_vars": variables}}
        self._task = ray.remote(_task()).options(**options)

    def has_room(self) -> bool:
        """Tell whether more indices should be submitted."""
        return len(self.indices) < self.nodes.room()

    def submit(self, index: int) -> None:
        """Let a node compute an index when one of its cores is free."""
        files = [self._ray.put(SentFile.read(path)) for path in self._inputs.get(index, ())]
        self.indices[self._task.remote(*self._arguments, index, files)] = index

    def finished(self) -> Iterator[tuple[int, Outcome | None]]:
        """Yield each index that is computed, with None if its worker or node was lost; none if it takes long.

        Raises:
            WorkerError: The cluster is lost, or a node is unsuitable. What the work raises is raised unchanged.
        """
        ready, _ = self._ray.wait(list(self.indices), timeout=_REFRESH)
        self.nodes.refresh()
        for reference in ready:
            yield self.indices.pop(reference), self._outcome(reference)

    def _outcome(self, reference: Any) -> Outcome | None:
        kinds = self._ray.exceptions
        try:
            answer: bytes = self._ray.get(reference)
        except kinds.RayTaskError as error:
            raise _cause(error) from error
        except (kinds.WorkerCrashedError, kinds.NodeDiedError, kinds.OutOfMemoryError, kinds.ObjectLostError):
            return None
        except kinds.RayError as error:
            raise WorkerError(f"the cluster is lost ({error}); {_HELP}") from error
        outcome: Outcome = pickle.loads(answer)  # here, where a result that fails is told from a cluster that does
        return outcome

    def cancel(self) -> None:
        """Stop what is being computed: files are written here, and atomically, so only unfinished work is lost."""
        global _nodes
        for reference in self.indices:
            with suppress(Exception):  # of a cluster that is lost
                self._ray.cancel(reference, force=True)
        _nodes = 0


def _cause(error: Any) -> BaseException:
    """Return what the work raised."""
    cause: BaseException = error.cause
    if isinstance(cause, ModuleNotFoundError) and (cause.name or "").split(".")[0] == "binpick_env":
        return WorkerError("a node of the cluster has no binpick: install the same build on every node")
    return cause


class _Nodes:
    """The nodes that compute, counted every few seconds."""

    def __init__(self, ray: Any) -> None:
        self._ray = ray
        self._head = ray.get_runtime_context().gcs_address
        self._cores = 0
        self._missing: float | None = None  # time since which no node computes, or none can be asked
        self._counted = time.monotonic()
        self._count()

    def room(self) -> int:
        """Return how many indices to submit."""
        return submitted(self._cores)

    def refresh(self) -> None:
        """Count the nodes, if it is time.

        Raises:
            WorkerError: For long, no head node or no other node has been there.
        """
        now = time.monotonic()
        if now - self._counted < _REFRESH:
            return
        self._counted = now
        reachable = _is_reachable(self._head)  # first: Ray ends a process that waits for a head node for a minute
        if reachable:
            self._count()
        if reachable and self._cores:
            self._missing = None
        elif self._missing is None:
            self._missing = now
        elif now - self._missing > _PATIENCE:
            raise WorkerError(f"the cluster at {self._head} is lost, or none of its nodes computes; {_HELP}")

    def _count(self) -> None:
        global _nodes
        cores = [int(node["Resources"].get("CPU", 0)) for node in self._ray.nodes() if node["Alive"]]
        self._cores, _nodes = sum(cores), sum(each > 0 for each in cores)


def _is_reachable(address: str) -> bool:
    host, _, port = address.rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=1.0):
            return True
    except OSError:
        return False


def _join(cluster: Cluster) -> Any:
    """Return Ray, connected to the cluster."""
    global _joined
    try:
        import ray
    except ModuleNotFoundError as error:
        raise WorkerError("a cluster needs Ray, which is not installed: pip install 'binpick[cluster]'") from error
    if ray.is_initialized():
        if _joined in (None, cluster):  # None: the caller's own program has joined one
            return ray
        ray.shutdown()
    if ":" in cluster.address and not _is_reachable(cluster.address):  # Ray would try for minutes
        raise WorkerError(f"nothing answers at {cluster.address}, which must be the head node's address; {_HELP}")
    try:
        ray.init(cluster.address, log_to_driver=False, logging_level="WARNING", **_options(cluster))
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise WorkerError(f"the cluster {cluster.address} cannot be joined ({error}); {_HELP}") from error
    _joined = cluster
    return ray


def _options(cluster: Cluster) -> dict[str, Any]:
    """Return the options of a cluster that is started; one that is joined has its own."""
    if cluster.address != LOCAL:
        return {}
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is sent anywhere
    return {
        "num_cpus": cluster.workers,
        "object_store_memory": _STORE,
        "include_dashboard": False,
        "_system_config": {"worker_niceness": 0},  # as processes of this machine: Ray's own have the lowest priority
    }


def leave_cluster() -> None:
    """Leave the cluster that this process has joined, if any; one that it started ends. Its end does the same."""
    global _joined
    if _joined is not None:
        import ray

        ray.shutdown()
        _joined = None


def _task() -> Callable[..., bytes]:
    """Return the function of a task, which is pickled by value: a node without the project can say so."""

    def compute_index(key: str, required: dict[str, str], job: list[Any], index: int, inputs: list[Any]) -> bytes:
        import ray
        from cloudpickle import dumps

        from binpick_env.jobs.node import compute

        outcome = compute(key, required, lambda: ray.get(job[0]), index, lambda: ray.get(inputs))
        return dumps(outcome)  # type: ignore[no-any-return]

    return compute_index
