"""One cell for all tests of a file, put back to its start before each; and a cache of a test's own."""

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.register_assert_rewrite("tests.binpick_env.small_cell")

from binpick_env.cell.simulation import Simulation  # noqa: E402
from binpick_env.env import BinPickEnv  # noqa: E402
from tests.binpick_env.small_cell import small_env, small_simulation  # noqa: E402
from tests.shared_models import share_models  # noqa: E402


@pytest.fixture(autouse=True, scope="session")
def _models_are_shared() -> None:
    share_models()


@pytest.fixture(scope="module")
def shared_env() -> Iterator[BinPickEnv]:
    env = small_env()
    yield env
    env.close()


@pytest.fixture
def env(shared_env: BinPickEnv) -> BinPickEnv:
    shared_env.reset(seed=0)
    return shared_env


@pytest.fixture(scope="module")
def shared_simulation() -> Simulation:
    return small_simulation()


@pytest.fixture
def simulation(shared_simulation: Simulation) -> Simulation:
    shared_simulation.reset()
    return shared_simulation


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache"
    monkeypatch.setenv("BINPICK_CACHE", str(folder))
    return folder
