"""The simulation of a map over a cluster, against times that can be computed by hand."""

import math
from dataclasses import replace

import pytest

from policies.benchmarks.clusters import Items, Machines, Schedule, Transport, simulate

ITEMS = Items(count=200, seconds=2.0, spread=1e-6, megabytes=0.0)
READY = Machines(cores=4, start=0.0, compilation=0.0, network=100.0, job=0.0)
FREE = Transport(item=0.0, megabyte=0.0)


def test_without_costs_the_rate_is_that_of_all_cores() -> None:
    # Three cores of the node wait for its first item.
    for cores, seconds in ((1, 400.0), (4, 2.0 * math.ceil((200 - 1) / 4) + 2.0)):
        found = simulate(ITEMS, replace(READY, cores=cores), FREE)
        assert found.seconds == pytest.approx(seconds, rel=1e-4)
        assert found.efficiency == pytest.approx(400.0 / cores / seconds, rel=1e-4)
        assert (found.taking, found.network) == (0.0, 0.0)
    assert simulate(ITEMS, replace(READY, cores=1), FREE).limit == "cores"


def test_nodes_wait_for_the_job_and_for_their_first_item() -> None:
    machines = replace(READY, cores=2, node_cores=1, start=5.0, compilation=7.0, job=300.0)
    found = simulate(replace(ITEMS, count=2), machines, FREE)
    # The second node has the job after two transfers of three seconds.
    assert found.seconds == pytest.approx(5.0 + 2 * 3.0 + 7.0 + 2.0, rel=1e-4)


def test_one_process_takes_so_many_results_a_second() -> None:
    transport = Transport(item=0.05, megabyte=0.1)
    found = simulate(replace(ITEMS, megabytes=0.5), replace(READY, cores=1000), transport)
    # It submits all of them while the first ones are computed.
    assert found.seconds == pytest.approx(200 * 0.05 + 200 * (0.05 + 0.05), rel=0.02)
    assert found.limit == "process that takes results"
    assert found.taking > 0.9


def test_the_network_brings_so_many_results_a_second() -> None:
    found = simulate(replace(ITEMS, megabytes=50.0), replace(READY, cores=100), FREE)
    assert found.seconds == pytest.approx(2.0 + 200 * 0.5, rel=0.02)
    assert (found.limit, found.network > 0.9) == ("network", True)


def test_more_cores_than_items_are_of_no_use() -> None:
    found = simulate(replace(ITEMS, count=10), replace(READY, cores=1000, node_cores=1), FREE)
    assert found.seconds == pytest.approx(2.0, rel=1e-4)
    assert found.limit == "start and end"


def test_the_seed_draws_the_times() -> None:
    items = replace(ITEMS, spread=0.5)
    first, again, other = (simulate(items, READY, FREE, seed) for seed in (0, 0, 1))
    assert first == again
    assert first != other
    assert isinstance(first, Schedule)


@pytest.mark.parametrize("name", ["count", "seconds", "spread", "megabytes"])
def test_items_that_make_no_sense_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=rf"{name} must (be positive|not be negative), got -1"):
        replace(ITEMS, **{name: -1})


@pytest.mark.parametrize("name", ["cores", "node_cores", "network", "start", "compilation", "job"])
def test_machines_that_make_no_sense_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=rf"{name} must (be positive|not be negative), got -1"):
        replace(READY, **{name: -1})


@pytest.mark.parametrize("name", ["item", "megabyte"])
def test_costs_that_make_no_sense_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=rf"{name} must not be negative, got nan"):
        replace(FREE, **{name: math.nan})
