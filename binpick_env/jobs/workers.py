"""Where long jobs are computed: in processes of this machine, or on a Ray cluster."""

import re
from dataclasses import dataclass

LOCAL, AUTO = "local", "auto"
_ADDRESS = re.compile(rf"{LOCAL}|{AUTO}|[\w.-]+:\d+")


class WorkerError(RuntimeError):
    """The workers cannot go on: one was killed, or a cluster is lost, unsuitable or not to be had."""


@dataclass(frozen=True, kw_only=True)
class Cluster:
    """A Ray cluster; see :doc:`/howto/cluster`.

    Attributes:
        address: "local" starts a cluster of this machine, "auto" joins the one that runs on this machine, and
            ``host:port`` that of a head node.
        workers: Number of processes of a cluster that is started; one that is joined has its own.
    """

    address: str = AUTO
    workers: int = 1

    def __post_init__(self) -> None:
        if not _ADDRESS.fullmatch(self.address):
            raise ValueError(f"cluster must be {LOCAL}, {AUTO} or host:port, got {self.address!r}")
        if self.workers < 1:
            raise ValueError(f"workers must be at least 1, got {self.workers}")


Workers = int | Cluster  # a number of processes of this machine, of which 1 is this one, or a cluster


def is_positive(workers: Workers) -> bool:
    """Tell whether there is a worker at all."""
    return isinstance(workers, Cluster) or workers >= 1
