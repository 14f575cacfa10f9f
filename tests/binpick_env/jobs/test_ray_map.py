"""A map over a cluster gives what one over processes gives, whatever happens to its workers."""

import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import trimesh

from binpick_env.config import CameraConfig
from binpick_env.jobs import ray_cluster, ray_map
from binpick_env.jobs.build import build
from binpick_env.jobs.process_map import map_indices
from binpick_env.jobs.workers import Cluster, WorkerError
from binpick_env.parts.part import load_part
from binpick_env.scenes.synthesis import SceneConfig, generate_scenes
from perception.runtime.file_work import FolderWork, InputWork, Run
from perception.runtime.provenance import command_line, git_commit
from perception.s3dis.data.prepare import prepare_rooms
from perception.s3dis.data.raw_tree import find_raw_rooms
from perception.s3dis.data.room import ROOMS_NOTE, find_rooms
from perception.s3dis.evaluation.identities import predict_merged_ground_truth_blocks
from perception.s3dis.scoring import S3disScores, match_rooms
from perception.s3dis.synthesis import SynthesisConfig, synthesize_rooms
from tests.binpick_env.jobs import cluster_works as works
from tests.local_cluster import CLUSTER, two_workers


@pytest.fixture(scope="module", autouse=True)
def cluster() -> Iterator[None]:
    with two_workers():
        yield


# --- results ---------------------------------------------------------------------------------------------------------


def test_workers_run_the_initializer_and_compute_on_one_core() -> None:
    results = list(map_indices(works.circumstances, range(6), CLUSTER, works.remember, ("started",)))
    assert sorted(result[0] for result in results) == list(range(6))
    assert os.getpid() not in {result[1] for result in results}
    assert {result[2] for result in results} == {"started"}
    assert all(set(result[3].values()) == {1} for result in results), results[0][3]


def test_command_and_commit_are_those_of_the_machine_that_started_the_job() -> None:
    assert list(map_indices(works.provenance, [0], CLUSTER)) == [(command_line(), git_commit())]


def test_one_index_is_computed_on_the_cluster_and_none_needs_no_cluster() -> None:
    ((_, pid, _, _),) = map_indices(works.circumstances, [3], CLUSTER)
    assert pid != os.getpid()
    assert list(map_indices(works.square, [], Cluster(address="nowhere:1"))) == []


def test_files_arrive_before_the_result(tmp_path: Path) -> None:
    work = FolderWork(partial(works.write_letters, 256), tmp_path / "kept")
    for index in map_indices(work, range(3), CLUSTER):
        assert (tmp_path / "kept" / "more" / f"first {index}.bin").read_bytes() == bytes(range(256))
        assert (tmp_path / "kept" / f"last {index}.txt").read_text(encoding="utf-8") == "ß" * index
    assert len(list((tmp_path / "kept").rglob("*.*"))) == 6  # no draft is left


def test_files_arrive_with_the_index_that_reads_them_and_are_removed(tmp_path: Path) -> None:
    paths = [tmp_path / f"{k}.bin" for k in range(3)]
    for k, path in enumerate(paths):
        path.write_bytes(bytes([k]) * 300_000)  # too large to be sent within a task's description
    work = InputWork(partial(works.read_own, paths), {k: [path] for k, path in enumerate(paths)})
    for content, copy, there in map_indices(work, range(3), CLUSTER):
        k = content[0]
        assert content == paths[k].read_bytes()
        assert there == [index == k for index in range(3)]
        assert not copy.exists()


@pytest.mark.slow
def test_rooms_made_here_and_on_a_cluster_are_those_made_here(tmp_path: Path) -> None:
    config = SynthesisConfig(density=20)
    on_cluster: Run[Any] = partial(map_indices, workers=CLUSTER)
    here, mixed = tmp_path / "here", tmp_path / "mixed"
    made = sorted(synthesize_rooms(config, 3, here / "raw"))
    list(synthesize_rooms(config, 1, mixed / "raw"))
    (mixed / "raw" / "Area_2" / f".{Path(made[1]).name}.1").mkdir(parents=True)  # half of a room
    assert sorted(synthesize_rooms(config, 3, mixed / "raw", on_cluster)) == made
    raw = find_raw_rooms(here / "raw")
    done = {room.name: room for room in prepare_rooms(raw, here / "rooms")}
    list(prepare_rooms(raw[:1], mixed / "rooms"))
    again = {room.name: room for room in prepare_rooms(find_raw_rooms(mixed / "raw"), mixed / "rooms", on_cluster)}
    assert again == {**done, made[0]: replace(done[made[0]], new=False)}
    files, others = contents(here), contents(mixed)
    assert len(files) > 30
    assert files == others
    predict = predict_merged_ground_truth_blocks
    scores = S3disScores.of(list(match_rooms(predict, find_rooms(here / "rooms"))))
    assert S3disScores.of(list(match_rooms(predict, find_rooms(mixed / "rooms"), on_cluster))) == scores


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files in a folder, without the note that names the folder of the raw rooms."""
    paths = [path for path in folder.rglob("*") if path.is_file() and path.name != ROOMS_NOTE]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


@pytest.mark.slow
def test_scenes_made_here_and_on_a_cluster_are_those_made_here(tmp_path: Path) -> None:
    config = SceneConfig(num_parts=(2, 3), camera=CameraConfig(width=320, height=240))
    here, mixed = tmp_path / "here", tmp_path / "mixed"
    assert list(generate_scenes(config, 3, here)) == [0, 1, 2]
    assert list(generate_scenes(config, 1, mixed)) == [0]
    assert sorted(generate_scenes(config, 3, mixed, CLUSTER)) == [0, 1, 2]
    files = {path.name: path.read_bytes() for path in here.iterdir()}
    assert len(files) == 4
    assert {path.name: path.read_bytes() for path in mixed.iterdir()} == files


def test_a_parts_file_travels_and_keeps_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box((0.06, 0.04, 0.02)).export("block.stl")
    part = load_part("block.stl")
    results = list(map_indices(partial(works.weigh_without_the_file, "block.stl"), range(2), CLUSTER))
    assert results == 2 * [(part.mass, str(tmp_path.resolve() / "block.stl"), "block")]


def test_installed_weights_travel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path))
    (tmp_path / "weights").mkdir()
    (tmp_path / "weights" / "tee.safetensors").write_bytes(b"a network")
    (tmp_path / "weights" / "tee.json").write_text("{}")
    assert list(map_indices(works.installed, [0], CLUSTER)) == [{"tee.safetensors": b"a network"}]


def within(seconds: float, happens: Callable[[], bool]) -> bool:
    """Wait until something happens; return whether it did."""
    deadline = time.monotonic() + seconds
    while not happens() and time.monotonic() < deadline:
        time.sleep(0.02)
    return happens()


# --- trouble ---------------------------------------------------------------------------------------------------------


def test_a_node_of_another_build_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    other = {**build(), "mujoco": "9.9"}
    monkeypatch.setattr(ray_map, "build", lambda: other)
    with pytest.raises(WorkerError, match=r"runs another build of binpick than this machine \(mujoco: 9.9, "):
        list(map_indices(works.square, [1], CLUSTER))


def test_a_node_without_the_project_is_named() -> None:
    missing = SimpleNamespace(cause=ModuleNotFoundError("No module named 'binpick_env'", name="binpick_env.jobs"))
    with pytest.raises(WorkerError, match="a node of the cluster has no binpick: install the same build"):
        raise ray_cluster._cause(missing)
    other = ModuleNotFoundError("No module named 'rerun'", name="rerun")
    assert ray_cluster._cause(SimpleNamespace(cause=other)) is other


def test_a_head_that_listens_is_reachable() -> None:
    import ray

    address = ray.get_runtime_context().gcs_address
    assert ray_cluster._is_reachable(address)
    assert not ray_cluster._is_reachable("127.0.0.1:1")


def test_a_result_that_cannot_be_pickled_is_an_error_of_the_work() -> None:
    with pytest.raises(TypeError, match="cannot pickle"):
        list(map_indices(works.make_lock, [1], CLUSTER))


def test_a_cluster_that_fails_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    import ray

    def get(reference: object) -> None:
        raise ray.exceptions.LocalRayletDiedError

    monkeypatch.setattr(ray, "get", get)
    with pytest.raises(WorkerError, match=r"the cluster is lost \(.*raylet died.*\); see docs/howto/cluster.md"):
        list(map_indices(works.square, [1], CLUSTER))


def test_an_error_of_the_work_is_raised_unchanged() -> None:
    with pytest.raises(FloatingPointError, match="index 1 diverged") as caught:
        list(map_indices(partial(works.fail_at, 1), range(4), CLUSTER))
    assert type(caught.value) is FloatingPointError


def test_the_index_of_a_killed_worker_is_computed_again(tmp_path: Path) -> None:
    (tmp_path / "input").touch()
    work = InputWork(partial(works.die_once, tmp_path, 2), {2: [tmp_path / "input"]})
    assert sorted(map_indices(work, range(6), CLUSTER)) == list(range(6))
    assert (tmp_path / "died").exists()


def test_an_index_that_kills_its_workers_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_map, "ATTEMPTS", 2)
    with pytest.raises(WorkerError, match="index 5 was given up, since 2 workers were lost over it"):
        list(map_indices(works.die, [5], CLUSTER))


def test_few_indices_wait_on_the_cluster(monkeypatch: pytest.MonkeyPatch) -> None:
    submitted: list[int] = []
    submit = ray_map._Started.submit
    monkeypatch.setattr(ray_map._Started, "submit", lambda self, index: (submitted.append(index), submit(self, index)))
    results = map_indices(works.square, range(100_000), CLUSTER)
    assert next(results) in {index * index for index in range(20)}
    assert ray_cluster.nodes_in_use() == 1
    assert len(submitted) == 8
    results.close()  # type: ignore[attr-defined]
    assert ray_cluster.nodes_in_use() == 0


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes as Linux lists them")
def test_an_iteration_that_is_closed_early_stops_what_is_computed(tmp_path: Path) -> None:
    results = map_indices(partial(works.linger, tmp_path), range(2), CLUSTER)
    assert next(results) == 0
    assert within(30, (tmp_path / "pid").exists)
    process = Path("/proc") / (tmp_path / "pid").read_text() / "stat"
    assert process.exists()
    results.close()  # type: ignore[attr-defined]
    assert within(20, lambda: not process.exists())


def test_a_cluster_whose_head_is_gone_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_cluster, "_REFRESH", 0.05)
    monkeypatch.setattr(ray_cluster, "_PATIENCE", 0.2)
    monkeypatch.setattr(ray_cluster, "_is_reachable", lambda address: False)
    with pytest.raises(WorkerError, match=r"the cluster at .*:\d+ is lost, or none of its nodes computes; see docs"):
        list(map_indices(partial(works.linger, tmp_path), [1], CLUSTER))


# --- joining ---------------------------------------------------------------------------------------------------------


class FakeRay(SimpleNamespace):
    """Remembers how it is started."""

    def __init__(self, error: Exception | None = None) -> None:
        super().__init__(calls=[], joined=False, error=error)

    def is_initialized(self) -> bool:
        return bool(self.joined)

    def init(self, address: str, **options: object) -> None:
        if self.error is not None:
            raise self.error
        self.joined = True
        self.calls.append((address, options.get("num_cpus")))

    def shutdown(self) -> None:
        self.joined = False


@pytest.fixture
def apart(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_cluster, "_joined", None)


def test_ray_is_needed(apart: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(WorkerError, match=r"needs Ray, which is not installed: pip install 'binpick\[cluster\]'"):
        list(map_indices(works.square, [1], CLUSTER))


def test_a_cluster_that_is_not_there_is_named(apart: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", FakeRay(ConnectionError("no running instance")))
    with pytest.raises(WorkerError, match=r"the cluster auto cannot be joined \(no running instance\); see docs"):
        ray_cluster.join(Cluster(address="auto"))


def test_a_head_that_does_not_answer_is_named_at_once(apart: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", FakeRay())
    with pytest.raises(WorkerError, match=r"nothing answers at 127\.0\.0\.1:1, which must be the head node's address"):
        ray_cluster.join(Cluster(address="127.0.0.1:1"))


def test_a_cluster_is_joined_once_and_left_for_another(apart: None, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = FakeRay()
    monkeypatch.setitem(sys.modules, "ray", fake)
    for cluster in 2 * [Cluster(address="local", workers=3)] + [Cluster(address="auto")]:
        assert ray_cluster.join(cluster) is fake
    assert fake.calls == [("local", 3), ("auto", None)]
