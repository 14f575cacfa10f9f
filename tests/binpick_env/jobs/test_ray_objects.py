"""Objects on a cluster remember what was called, and are made anew where their workers are lost."""

import os
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from binpick_env.jobs import ray_cluster, ray_objects
from binpick_env.jobs.build import build
from binpick_env.jobs.ray_objects import ClusterObjects
from binpick_env.jobs.workers import WorkerError
from tests.binpick_env.jobs import cluster_works as works
from tests.local_cluster import CLUSTER, two_workers


@pytest.fixture(scope="module", autouse=True)
def cluster() -> Iterator[None]:
    with two_workers():
        yield


@pytest.fixture
def objects(tmp_path: Path) -> Iterator[ClusterObjects]:
    """Two objects that read a file when they are made; it is not there any longer when they are made anew."""
    (tmp_path / "seed.txt").write_bytes(b"a file")
    made = ClusterObjects(partial(works.Counting, str(tmp_path / "seed.txt")), 2, CLUSTER)
    (tmp_path / "seed.txt").unlink()
    yield made
    made.close()


def answers(objects: ClusterObjects, count: int) -> dict[int, Any]:
    """Return the results of so many calls, by index; None for lost objects."""
    found: dict[int, Any] = {}
    while len(found) < count:
        found |= {index: outcome and outcome.result for index, outcome in objects.finished()}
    return found


def ask(objects: ClusterObjects, method: str, *arguments: Any) -> dict[int, Any]:
    for index in range(2):
        objects.call(index, method, *arguments)
    return answers(objects, 2)


def test_objects_remember_on_one_core_each_with_the_files_that_they_name(objects: ClusterObjects) -> None:
    assert ask(objects, "count", 3) == {0: (0, 3), 1: (1, 3)}
    assert ask(objects, "count", 2) == {0: (0, 5), 1: (1, 5)}
    assert ask(objects, "file") == {0: b"a file", 1: b"a file"}
    found = ask(objects, "circumstances")
    assert len({os.getpid(), found[0][1], found[1][1]}) == 3
    assert all(set(each[3].values()) == {1} for each in found.values())
    assert ray_cluster.nodes_in_use() == 1
    objects.close()
    assert ray_cluster.nodes_in_use() == 0


def test_a_lost_object_is_made_anew_and_the_other_one_stays(objects: ClusterObjects) -> None:
    ask(objects, "count", 1)
    objects.call(0, "die")
    assert answers(objects, 1) == {0: None}
    assert ask(objects, "count", 1) == {0: (0, 1), 1: (1, 2)}
    assert ask(objects, "file") == {0: b"a file", 1: b"a file"}


def test_what_a_method_raises_is_raised_unchanged(objects: ClusterObjects) -> None:
    objects.call(1, "fail")
    with pytest.raises(FloatingPointError, match="object 1 diverged") as caught:
        answers(objects, 1)
    assert type(caught.value) is FloatingPointError
    objects.call(1, "missing")
    with pytest.raises(AttributeError, match="'Counting' object has no attribute 'missing'"):
        answers(objects, 1)


def test_a_node_of_another_build_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    other = {**build(), "mujoco": "9.9"}
    monkeypatch.setattr(ray_objects, "build", lambda: other)
    objects = ClusterObjects(works.square, 1, CLUSTER)
    objects.call(0, "bit_length")
    with pytest.raises(WorkerError, match=r"runs another build of binpick than this machine \(mujoco: 9.9, "):
        answers(objects, 1)
    objects.close()


def test_each_object_needs_a_core() -> None:
    with pytest.raises(WorkerError, match="the cluster has 2 cores: ask for as many workers, not 3"):
        ClusterObjects(works.square, 3, CLUSTER)
    assert ray_cluster.nodes_in_use() == 0


def test_objects_whose_cores_do_not_come_back_are_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_cluster, "_REFRESH", 0.05)
    monkeypatch.setattr(ray_cluster, "_PATIENCE", 0.2)
    objects = ClusterObjects(works.Sleeping, 2, CLUSTER)
    objects.call(0, "sleep", 30.0)
    monkeypatch.setattr(objects._nodes, "_needed", 3)  # as if the node with the third one were lost
    with pytest.raises(WorkerError, match=r"the cluster at .*:\d+ has 2 cores left, but 3 are needed; see docs"):
        answers(objects, 1)
    objects.close()


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes as Linux lists them")
def test_workers_end_when_objects_are_closed(objects: ClusterObjects) -> None:
    processes = [Path("/proc") / str(pid) for pid in ask(objects, "process").values()]
    assert all(process.exists() for process in processes)
    objects.close()
    deadline = time.monotonic() + 20
    while any(process.exists() for process in processes) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not any(process.exists() for process in processes)
