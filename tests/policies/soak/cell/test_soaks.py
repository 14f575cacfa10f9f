"""Short runs of the soak tests of both environments."""

from pathlib import Path

import numpy as np
import pytest

from binpick_env.env import BinPickEnv
from policies.soak.cell import EnvSoak, SelectSoak
from policies.soak.cell import env as env_module
from policies.soak.cell import select as select_module
from policies.soak.cell.actions import HostileActions
from policies.soak.cell.memory import MemorySettings, growth, resident_mb


@pytest.mark.slow
def test_hostile_steps_break_no_rule(tmp_path: Path) -> None:
    soak = EnvSoak(steps=1, chunk=80, parts=("tee",), num_parts=(3, 3))
    (unit,) = soak.units()
    result = soak.run(unit, tmp_path)
    assert result.problems == ()
    assert result.counts == {"steps": 80, "resets": 1}


@pytest.mark.slow
def test_random_decisions_break_no_rule(tmp_path: Path) -> None:
    soak = SelectSoak(decisions=1, chunk=3, parts=("tee",), num_parts=(3, 3), seed=3)
    (unit,) = soak.units()
    result = soak.run(unit, tmp_path)
    assert result.problems == ()
    assert result.counts["decisions"] == 3


@pytest.mark.slow
def test_the_growth_of_memory_is_a_number() -> None:
    assert resident_mb() > 50
    assert np.isfinite(growth(MemorySettings(resets=5, num_parts=(1, 1), perception="oracle")))


@pytest.mark.slow
def test_hostile_actions_are_within_the_space_and_reach_into_the_bin() -> None:
    env = BinPickEnv(part="tee", num_parts=2, perception="oracle", threads=1)
    env.reset(seed=0)
    hostile = HostileActions(env)
    rng = np.random.default_rng(0)
    assert all(env.action_space.contains(action) for action, _ in zip(hostile.draw(rng), range(500), strict=False))
    heights = [hostile._ik.tcp_pose(q)[2, 3] for q in hostile._pressed]
    assert max(heights) < 0.03  # at the floor or under it
    env.close()


@pytest.mark.parametrize("module", [env_module, select_module])
def test_a_crash_is_a_problem(module: object, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Not the end of the soak test."""
    name, soak = ("BinPickEnv", EnvSoak(steps=1)) if module is env_module else ("GraspSelectionEnv", SelectSoak())

    class Broken:
        def __init__(self, **_: object) -> None:
            from types import SimpleNamespace

            self.simulation = None
            self.cell = SimpleNamespace(simulation=None)

        def close(self) -> None:
            pass

    class Watch:
        steps = 0

        def __init__(self, _: object) -> None:
            self.problems: list[str] = []

        def watching(self) -> None:
            raise FloatingPointError("the physics diverged")

        def largest(self) -> dict[str, float]:
            return {}

    monkeypatch.setattr(module, name, Broken)
    monkeypatch.setattr(module, "CellWatch", Watch)
    assert soak.run(soak.units()[0], tmp_path).problems == ("FloatingPointError: the physics diverged",)


def test_growth_over_the_limit_is_a_problem(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(env_module, "growth_in_child", lambda _: 1.5)
    for resets, problems in ((1000, 1), (20, 0)):  # too few resets are not judged
        soak = EnvSoak(steps=1, memory=MemorySettings(resets=resets))
        assert soak.units()[-1] == f"memory-{resets}"
        assert len(soak.run(soak.units()[-1], tmp_path).problems) == problems


def test_a_longer_run_begins_with_the_units_of_a_shorter_one() -> None:
    assert EnvSoak(steps=1100).units()[:2] == EnvSoak(steps=1000).units()
    assert EnvSoak(steps=1000).settings() == EnvSoak(steps=5).settings()
    assert SelectSoak(decisions=41).units()[:2] == SelectSoak(decisions=40).units()
    assert SelectSoak(decisions=41).settings() == SelectSoak(decisions=40).settings()


def test_nonsense_is_refused() -> None:
    with pytest.raises(ValueError, match="steps and chunk must be at least 1, got 0 and 500"):
        EnvSoak(steps=0)
    with pytest.raises(ValueError, match="decisions and chunk must be at least 1, got 5 and 0"):
        SelectSoak(decisions=5, chunk=0)
    with pytest.raises(ValueError, match="resets must be at least 5, to fit a line, got 4"):
        MemorySettings(resets=4)
