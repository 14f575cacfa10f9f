"""A training on a cluster gives the selector of one in processes, whatever happens to its workers."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from stable_baselines3.common.vec_env import DummyVecEnv

from binpick_env.jobs import ray_cluster
from binpick_env.jobs.workers import WorkerError
from policies.selection.learning.ppo import CONFIG, PpoConfig, train_ppo
from policies.selection.weights import load_selector_net, load_selector_record
from tests.local_cluster import CLUSTER, two_workers
from tests.policies.selection.learning.dying_cells import DyingCells, DyingToys
from tests.policies.selection.learning.toy_selection import SMALL_NET

pytestmark = pytest.mark.slow  # each environment starts a process that loads torch
HERE = PpoConfig(network=SMALL_NET, n_envs=2, n_steps=8, batch_size=8)
THERE = replace(HERE, cluster=CLUSTER)


@pytest.fixture(scope="module", autouse=True)
def cluster() -> Iterator[None]:
    with two_workers():
        yield


@pytest.fixture
def one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("policies.selection.learning.ppo.SubprocVecEnv", lambda makers, **_: DummyVecEnv(makers))


def assert_same(first: Path, second: Path) -> None:
    """Compare selectors; the order of the metadata in their files is not fixed."""
    assert load_selector_record(first) == load_selector_record(second)
    weights = [load_selector_net(path).state_dict() for path in (first, second)]
    assert weights[0].keys() == weights[1].keys()
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])


def test_a_killed_worker_changes_nothing_and_the_next_stretch_is_trained_anywhere(
    tmp_path: Path, one_process: None
) -> None:
    toys = DyingToys(part="toy", folder=str(tmp_path), steps=9)
    there = train_ppo(THERE, toys, tmp_path / "there", 32)
    assert (tmp_path / "died").exists()
    assert ray_cluster.nodes_in_use() == 0
    here = train_ppo(HERE, toys, tmp_path / "here", 32)
    assert_same(here, there)
    assert "cluster" not in load_selector_record(there)["ppo"]
    assert (tmp_path / "here" / CONFIG).read_bytes() == (tmp_path / "there" / CONFIG).read_bytes()
    train_ppo(THERE, toys, tmp_path / "here", 48)
    train_ppo(HERE, toys, tmp_path / "there", 48)
    assert_same(here, there)
    assert load_selector_record(here)["picks"] == 48


def test_what_an_environment_raises_ends_the_training(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="part must be"):
        train_ppo(replace(THERE, n_envs=1), DyingCells(part="nobody", folder="", steps=1), tmp_path, 8)
    with pytest.raises(WorkerError, match="the cluster has 2 cores: ask for as many workers, not 3"):
        train_ppo(replace(THERE, n_envs=3), DyingToys(folder="", steps=1), tmp_path / "more", 8)


def test_the_selector_is_that_of_processes_with_real_picks(tmp_path: Path) -> None:
    """A worker is killed after some bins, so that its place is taken by an environment that has played none of them."""
    few = {"min_parts": 2, "max_parts": 3, "fast": True, "width": 320, "height": 240}
    cells = DyingCells(**few, folder=str(tmp_path), steps=7)  # type: ignore[arg-type]
    there = train_ppo(THERE, cells, tmp_path / "there", 16)
    assert (tmp_path / "died").exists()
    here = train_ppo(HERE, cells, tmp_path / "here", 16)
    assert_same(here, there)
    assert load_selector_record(here)["rates"]["dr"] > 0
