"""A Ray cluster: how it is joined and left, its nodes, and what has become of work that was sent to them.

Ray is imported only where a cluster is asked for.
"""

import os
import pickle
import socket
import time
from collections.abc import Iterable
from typing import Any

from binpick_env.jobs.cluster_job import Outcome
from binpick_env.jobs.workers import LOCAL, Cluster, WorkerError
from perception.runtime.provenance import COMMAND, COMMIT, command_line, git_commit
from perception.runtime.threads import THREAD_VARIABLES

ATTEMPTS = 4  # number of workers that are lost over a piece of work before it is given up
GIVEN_UP = (
    "{what} was given up, since {attempts} workers were lost over it, perhaps for want of memory: try fewer "
    "workers, that is fewer CPUs on each node (ray start --num-cpus)"
)
_REFRESH = 2.0  # time after which nodes are counted again [s]
_PATIENCE = 30.0  # time without a head node, or without enough cores, after which the cluster is lost [s]
_STORE = 512 * 1024**2  # memory for results on their way in a cluster of this machine [bytes]
_PASSED_ON = ("MUJOCO_GL", "PYOPENGL_PLATFORM")  # variables that choose what draws pictures
_HELP = "see docs/howto/cluster.md, and `ray status` on the head node"

_joined: Cluster | None = None  # the cluster that this process has joined
_nodes = 0  # number of nodes that compute


def nodes_in_use() -> int:
    """Return the number of nodes that compute for this process, 0 without a cluster."""
    return _nodes


def join(cluster: Cluster) -> Any:
    """Return Ray, connected to the cluster.

    Raises:
        WorkerError: Ray is not installed, or the cluster cannot be joined.
    """
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


def leave_cluster() -> None:
    """Leave the cluster that this process has joined, if any; one that it started ends. Its end does the same."""
    global _joined
    if _joined is not None:
        import ray

        ray.shutdown()
        _joined = None


def variables() -> dict[str, str]:
    """Return the environment variables of worker processes: they compute on one thread, and know the command."""
    passed_on = {name: os.environ[name] for name in _PASSED_ON if name in os.environ}
    return dict.fromkeys(THREAD_VARIABLES, "1") | {COMMIT: git_commit(), COMMAND: command_line()} | passed_on


def answer(ray: Any, reference: Any) -> Outcome | None:
    """Return what a node has sent back, or None if the worker or its node was lost.

    Raises:
        WorkerError: The cluster is lost, or the node is unsuitable. What the work raised is raised unchanged.
    """
    kinds = ray.exceptions
    lost = (kinds.WorkerCrashedError, kinds.RayActorError, kinds.NodeDiedError, kinds.OutOfMemoryError)
    try:
        sent: bytes = ray.get(reference)
    except kinds.RayTaskError as error:
        raise _cause(error) from error
    except (*lost, kinds.ObjectLostError):
        return None
    except kinds.RayError as error:
        raise WorkerError(f"the cluster is lost ({error}); {_HELP}") from error
    outcome: Outcome = pickle.loads(sent)  # here, where a result that fails is told from a cluster that does
    return outcome


def _cause(error: Any) -> BaseException:
    """Return what the work raised."""
    cause: BaseException = error.cause
    if isinstance(cause, ModuleNotFoundError) and (cause.name or "").split(".")[0] == "binpick_env":
        return WorkerError("a node of the cluster has no binpick: install the same build on every node")
    return cause


class Nodes:
    """The nodes that compute, counted every few seconds.

    Args:
        ray: Ray, connected to the cluster.
        needed: Number of cores that are needed at once.

    Attributes:
        cores: Number of cores that compute.
    """

    def __init__(self, ray: Any, needed: int = 1) -> None:
        self.cores = 0
        self._ray, self._needed = ray, needed
        self._head = ray.get_runtime_context().gcs_address
        self._missing: float | None = None  # time since which cores are missing, or none can be asked
        self._counted = time.monotonic()
        self._count()

    def wait(self, references: Iterable[Any]) -> list[Any]:
        """Return the references of what is done; none if it takes long.

        Raises:
            WorkerError: For long, no head node or too few cores have been there.
        """
        ready, _ = self._ray.wait(list(references), timeout=_REFRESH)
        self._refresh()
        return list(ready)

    def leave(self) -> None:
        """Note that no node computes any longer."""
        global _nodes
        _nodes = 0

    def _refresh(self) -> None:
        now = time.monotonic()
        if now - self._counted < _REFRESH:
            return
        self._counted = now
        reachable = _is_reachable(self._head)  # first: Ray ends a process that waits for a head node for a minute
        if reachable:
            self._count()
        if reachable and self.cores >= self._needed:
            self._missing = None
        elif self._missing is None:
            self._missing = now
        elif now - self._missing > _PATIENCE:
            raise WorkerError(self._what_is_missing(reachable))

    def _what_is_missing(self, reachable: bool) -> str:
        if reachable and self.cores:
            return f"the cluster at {self._head} has {self.cores} cores left, but {self._needed} are needed; {_HELP}"
        return f"the cluster at {self._head} is lost, or none of its nodes computes; {_HELP}"

    def _count(self) -> None:
        global _nodes
        cores = [int(node["Resources"].get("CPU", 0)) for node in self._ray.nodes() if node["Alive"]]
        self.cores, _nodes = sum(cores), sum(each > 0 for each in cores)


def _is_reachable(address: str) -> bool:
    host, _, port = address.rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=1.0):
            return True
    except OSError:
        return False


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
