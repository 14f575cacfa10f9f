"""A simulation of a map over a cluster: cores compute, a network brings results, and one process takes them."""

import heapq
import math
from dataclasses import dataclass

import numpy as np

from binpick_env.jobs.ray_map import submitted

BUSY = 0.9  # share of the time from which on a resource is what limits the rate
_READY, _COMPUTED, _TAKEN = range(3)


@dataclass(frozen=True, kw_only=True)
class Items:
    """What is computed.

    Attributes:
        count: Number of items.
        seconds: Mean time of an item on one core [s].
        spread: Standard deviation of the time, as a share of its mean.
        megabytes: Size of an item's result with its files [MB].
    """

    count: int
    seconds: float
    spread: float = 0.3
    megabytes: float = 0.1

    def __post_init__(self) -> None:
        _require_positive(self, "count", "seconds", "spread")
        _require_not_negative(self, "megabytes")


@dataclass(frozen=True, kw_only=True)
class Machines:
    """Where it is computed.

    Attributes:
        cores: Number of cores in all.
        node_cores: Number of cores of a node.
        start: Time until a new worker process begins its first item, without that of the job's transfer [s].
        compilation: Time that the first item of a node takes longer, while its other cores wait [s].
        network: Rate of the network [MB/s], that of each node and that of the machine that started the job.
        job: Size of the files that travel to each node [MB].
    """

    cores: int
    node_cores: int = 16
    start: float = 10.0
    compilation: float = 60.0
    network: float = 100.0
    job: float = 15.0

    def __post_init__(self) -> None:
        _require_positive(self, "cores", "node_cores", "network")
        _require_not_negative(self, "start", "compilation", "job")


@dataclass(frozen=True, kw_only=True)
class Transport:
    """What the process that started the job spends on results.

    Attributes:
        item: Time for an item, from its submission to its result [s].
        megabyte: Time for a megabyte of results, written to its disk [s].
    """

    item: float
    megabyte: float

    def __post_init__(self) -> None:
        _require_not_negative(self, "item", "megabyte")


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """How long the items take.

    Attributes:
        seconds: Time from the start to the last result [s].
        efficiency: Time of all items on one core, as a share of the time of all cores.
        taking: Share of the time in which the process that started the job was busy with results.
        network: Share of the time in which its network was.
    """

    seconds: float
    efficiency: float
    taking: float
    network: float

    @property
    def limit(self) -> str:
        """What the rate is limited by."""
        if self.network >= max(BUSY, self.taking):
            return "network"
        if self.taking >= BUSY:
            return "process that takes results"
        return "cores" if self.efficiency >= BUSY else "start and end"


def simulate(items: Items, machines: Machines, transport: Transport, seed: int = 0) -> Schedule:
    """Return how long a map takes, by the rules of :func:`binpick_env.jobs.ray_map.map_on_cluster`.

    Each core computes one item at a time. The process that started the job submits a limited number of items ahead, and
    another one for each result that it has taken. Results travel one after the other to it. The job travels from node
    to node, each time to twice as many.

    Args:
        items: What is computed; times are drawn from a gamma distribution.
        machines: Where it is computed.
        transport: What results cost the process that started the job.
        seed: Seed of the times.
    """
    cores = machines.cores
    shape = 1.0 / items.spread**2
    times = np.random.default_rng(seed).gamma(shape, items.seconds / shape, items.count).tolist()
    waiting = ahead = min(submitted(cores), items.count)  # items that are submitted and not begun; submitted in all
    free = taking = ahead * transport.item  # time at which the process is free again, and in which it was busy
    line = items.megabytes / machines.network
    line_free, begun, taken = 0.0, 0, 0
    now, idle = 0.0, list[int]()
    events = [(_arrival(core // machines.node_cores, machines), _READY, core) for core in _first_cores(machines)]
    heapq.heapify(events)
    compiling = {core for _, _, core in events}  # first cores of nodes that have not finished an item
    while taken < items.count:
        now, kind, core = heapq.heappop(events)
        cores_now = [core]
        if kind == _COMPUTED:
            line_free = max(line_free, now) + line
            cost = transport.item + items.megabytes * transport.megabyte
            free, taking = max(free, line_free) + cost, taking + cost
            heapq.heappush(events, (free, _TAKEN, -1))
            if core in compiling:
                compiling.remove(core)
                cores_now = list(range(core, min(core + machines.node_cores, cores)))
        elif kind == _TAKEN:
            taken += 1
            if ahead == items.count:
                continue
            ahead, waiting = ahead + 1, waiting + 1
            cores_now = [idle.pop()] if idle else []
        for one in cores_now:
            if waiting == 0:
                idle.append(one)
                continue
            longer = machines.compilation if one in compiling else 0.0
            heapq.heappush(events, (now + times[begun] + longer, _COMPUTED, one))
            begun, waiting = begun + 1, waiting - 1
    return Schedule(
        seconds=now,
        efficiency=sum(times) / (cores * now),
        taking=taking / now,
        network=items.count * line / now,
    )


def _first_cores(machines: Machines) -> range:
    return range(0, machines.cores, machines.node_cores)


def _arrival(node: int, machines: Machines) -> float:
    """Return the time at which a node has the job, and a worker is ready."""
    return machines.start + math.ceil(math.log2(node + 2)) * machines.job / machines.network


def _require_positive(of: object, *names: str) -> None:
    for name in names:
        if not 0 < getattr(of, name) < math.inf:
            raise ValueError(f"{name} must be positive, got {getattr(of, name)}")


def _require_not_negative(of: object, *names: str) -> None:
    for name in names:
        if not 0 <= getattr(of, name) < math.inf:
            raise ValueError(f"{name} must not be negative, got {getattr(of, name)}")
