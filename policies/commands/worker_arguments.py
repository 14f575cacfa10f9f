"""Where a command computes, the same options on every command whose work is a map over scenes or bins."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from binpick_env.jobs.workers import Workers


@dataclass(frozen=True, kw_only=True)
class WorkerArguments:
    """Number and place of the processes."""

    workers: int = 2  # number of processes, each on one core
    # compute on a Ray cluster, on all of its cores: the address host:port of its head node, auto for the cluster that
    # this machine belongs to, or local to start one of --workers processes here
    cluster: str | None = None

    def places(self) -> "Workers":
        """Return where the command computes.

        Raises:
            ValueError: The address or the number of processes has no meaning.
        """
        from binpick_env.jobs.workers import Cluster

        return self.workers if self.cluster is None else Cluster(address=self.cluster, workers=self.workers)
