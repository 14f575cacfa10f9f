"""The worker processes of an evaluation. One test starts some; the others pickle what would cross to them."""

import gc
import os
import pickle
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from binpick_env.jobs import ray_map
from binpick_env.jobs.workers import Cluster, WorkerError
from policies.evaluation import jobs
from policies.evaluation.bin_evaluation import BinError
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.jobs import Job, run_job
from policies.evaluation.records import BinRecord
from tests.binpick_env.jobs.node_map import node_map
from tests.policies.evaluation.test_listeners import FileListeners
from tests.policies.fake_cell import broken_cell, dice_cell

CONFIG = EvaluationConfig(num_parts=(6, 6))


def pickled(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))


class MapHere:
    """Maps as `map_indices` does over several processes, but in this one."""

    closed = False

    def __call__(
        self,
        work: Callable[[int], Any],
        indices: Sequence[int],
        workers: int,
        initializer: Callable[..., None],
        initargs: tuple[Any, ...],
    ) -> Iterator[Any]:
        assert workers == 2
        work, initializer, initargs = pickled((work, initializer, initargs))
        initializer(*initargs)
        try:
            for index in indices:
                try:
                    result = work(index)
                except Exception as error:
                    raise pickled(error) from None
                yield pickled(result)
        finally:
            self.closed = True


@pytest.fixture
def map_here(monkeypatch: pytest.MonkeyPatch) -> MapHere:
    here = MapHere()
    monkeypatch.setattr(jobs, "map_indices", here)
    monkeypatch.setattr(jobs, "_cells", jobs._cells)  # which the initializer replaces
    return here


def outcome_of(record: BinRecord) -> tuple[object, ...]:
    """Return everything in a record except for wall clock."""
    return record.index, record.seed, record.picks, record.delivered, record.termination, record.clutter


@pytest.mark.slow
def test_workers_make_the_listeners_and_the_same_records_each_on_disk_when_it_is_reported(tmp_path: Path) -> None:
    on_disk: list[bool] = []

    def look(record: BinRecord) -> None:
        on_disk.append((tmp_path / f"bin_{record.index:04d}.json").exists())

    job = Job(out=tmp_path, bins=3, workers=2, listeners=FileListeners())
    records = run_job(CONFIG, job, look, make_cell=dice_cell)
    assert on_disk == [True] * 3
    alone = run_job(CONFIG, Job(out=tmp_path / "alone", bins=3), make_cell=dice_cell)
    assert [outcome_of(record) for record in records] == [outcome_of(record) for record in alone]
    listened = sorted(tmp_path.glob("listened_*"))
    assert [path.name for path in listened] == ["listened_0", "listened_1", "listened_2"]
    assert str(os.getpid()) not in {path.read_text() for path in listened}


def test_a_killed_worker_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(*_: object) -> Iterator[BinRecord]:
        raise WorkerError("a worker was killed, perhaps for want of memory; try fewer workers")
        yield

    monkeypatch.setattr(jobs, "map_indices", killed)
    with pytest.raises(BinError, match=r"^a worker was killed, perhaps for want of memory; try fewer workers$"):
        run_job(CONFIG, Job(out=tmp_path, bins=3, workers=2), make_cell=dice_cell)
    assert list(tmp_path.glob("bin_*.json")) == []


def test_a_crash_in_a_worker_names_the_bin_and_its_seed(tmp_path: Path, map_here: MapHere) -> None:
    with pytest.raises(BinError, match=r"bin \d \(seed \d+\) failed: FloatingPointError"):
        run_job(CONFIG, Job(out=tmp_path, bins=2, workers=2), make_cell=broken_cell)
    assert map_here.closed


def test_an_interrupt_stops_the_workers(tmp_path: Path, map_here: MapHere) -> None:
    def interrupt(record: BinRecord) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_job(CONFIG, Job(out=tmp_path, bins=3, workers=2), on_bin=interrupt, make_cell=dice_cell)
    gc.collect()
    assert map_here.closed  # `map_indices` ends its processes when it is closed
    assert [path.name for path in tmp_path.glob("bin_*.json")] == ["bin_0000.json"]


@pytest.fixture
def on_node(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> list[int]:
    """Indices that a cluster is asked for; they are computed as on a node."""
    asked: list[int] = []

    def count(work: Any, indices: Sequence[int], *others: Any) -> Iterator[Any]:
        asked.extend(indices)
        return node_map(work, indices, *others)

    monkeypatch.setattr(ray_map, "map_on_cluster", count)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path_factory.mktemp("node")))
    monkeypatch.setattr(jobs, "_cells", jobs._cells)
    return asked


def test_a_cluster_gives_the_same_records_and_files(tmp_path: Path, on_node: list[int]) -> None:
    here, there = (tmp_path / name for name in ("here", "there"))
    job = Job(out=there, bins=3, workers=Cluster(), listeners=FileListeners())
    records = run_job(CONFIG, job, make_cell=dice_cell)
    alone = run_job(CONFIG, replace(job, out=here, workers=1), make_cell=dice_cell)
    assert on_node == [0, 1, 2]
    assert [outcome_of(record) for record in records] == [outcome_of(record) for record in alone]
    assert sorted(path.name for path in there.iterdir()) == sorted(path.name for path in here.iterdir())


def test_bins_that_are_filmed_are_picked_here_and_the_others_on_the_cluster(tmp_path: Path, on_node: list[int]) -> None:
    job = Job(out=tmp_path, bins=3, workers=Cluster(), listeners=FileListeners(needed=(1,)))
    assert [record.index for record in run_job(CONFIG, job, make_cell=dice_cell)] == [0, 1, 2]
    assert on_node == [0, 2]
