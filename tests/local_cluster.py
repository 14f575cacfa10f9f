"""A cluster of this machine with two worker processes, which whoever computes on ``Cluster(address="auto")`` finds."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from binpick_env.jobs.workers import Cluster

CLUSTER = Cluster(address="auto")


@contextmanager
def two_workers() -> Iterator[None]:
    ray = pytest.importorskip("ray", reason="needs Ray: pip install 'binpick[cluster]'")
    ray.init(
        "local", num_cpus=2, object_store_memory=80_000_000, include_dashboard=False,
        log_to_driver=False, logging_level="ERROR", _system_config={"worker_niceness": 0},
    )  # fmt: skip
    yield
    ray.shutdown()
