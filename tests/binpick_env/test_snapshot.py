"""Going back to a state: what follows is the same to the bit, and nothing of what came between is left."""

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from binpick_env.cell.delivery import Delivery
from binpick_env.cell.robot import HOME
from binpick_env.cell.simulation import Simulation
from binpick_env.config import BinConfig, CellConfig
from binpick_env.env import BinPickEnv
from binpick_env.parts import load_part
from tests.binpick_env.small_cell import REST, above_tray, act, assert_same, random_actions, small_env, small_simulation


@pytest.fixture
def env() -> BinPickEnv:
    env = small_env()
    env.reset(seed=31)
    return env


def later(env: BinPickEnv) -> list[Any]:
    """Move the arm at random, take two frames, and return all that can be observed of it."""
    moved = [env.step(action)[0] for action in random_actions(env, 12)]
    looks = [{**env.look(), "depth": env.frame.depth, "grey": env.frame.grey} for _ in range(2)]
    data = env.simulation.data
    return [*moved, *looks, {"qpos": data.qpos.copy(), "qvel": data.qvel.copy()}]


def assert_all_same(one: list[Any], other: list[Any]) -> None:
    assert len(one) == len(other)
    for first, second in zip(one, other, strict=True):
        assert_same(first, second)


def deliver(env: BinPickEnv) -> None:
    """Let a part that lies in the bin lie in the tray instead, and be judged."""
    env.simulation.place(0, above_tray(env.simulation))
    act(env, 1.5)


def facts(env: BinPickEnv) -> dict[str, Any]:
    """Return all that an environment, its simulation and its judge hold, by name; arrays are copied."""
    owners = {"env": env, "simulation": env.simulation, "judge": env._judge}
    whole = {id(env.episode)} | {id(owner) for owner in owners.values()} | {id(env.simulation.data), id(env.np_random)}
    held: dict[str, Any] = {}
    for owner, thing in owners.items():
        for name, value in vars(thing).items():
            if id(value) not in whole:
                held[f"{owner}.{name}"] = value.copy() if isinstance(value, np.ndarray | set | list) else value
    held |= {f"episode.{name}": value for name, value in vars(env.episode).items()}
    held["stop"] = env.simulation._stop.active
    held["gravcomp"] = env.simulation.model.body_gravcomp.copy()
    held["asleep"] = env.simulation.asleep()
    held["random"] = env.np_random.bit_generator.state
    return held


def differing(one: dict[str, Any], other: dict[str, Any]) -> set[str]:
    assert one.keys() == other.keys()
    return {name for name in one if not (one[name] is other[name] or np.array_equal(one[name], other[name]))}


def test_the_same_actions_bring_the_same_bits(env: BinPickEnv) -> None:
    """From the middle of a motion."""
    for action in random_actions(env, 5, seed=6):
        env.step(action)
    snapshot = env.snapshot()
    first = later(env)
    for _ in range(2):  # what came between does not reach the snapshot
        env.restore(snapshot)
        assert_all_same(later(env), first)


def test_another_cell_goes_on_as_the_first_would(env: BinPickEnv) -> None:
    act(env, 0.2)
    snapshot = env.snapshot()
    first = later(env)
    other = small_env()
    other.restore(snapshot)  # before any reset
    assert_all_same(later(other), first)
    other.reset(seed=8)
    deliver(other)
    other.restore(snapshot)
    assert_all_same(later(other), first)
    assert other.np_random_seed == 31


def test_nothing_is_left_of_what_came_between(env: BinPickEnv) -> None:
    """An attribute that is forgotten in a snapshot is named here."""
    deliver(env)
    assert [event.kind for event in env.events] == [Delivery.DELIVERED]
    before, snapshot = facts(env), env.snapshot()
    act(env, 0.8, np.append(HOME - [0.4, 0, 0, 0, 0, 0], 0.9).astype(np.float32))
    env.simulation.place(1, above_tray(env.simulation))
    act(env, 1.5, np.append(HOME, 0.0).astype(np.float32))
    act(env, 0.4, np.append(HOME + 0.4, 0.9).astype(np.float32))  # onto the bin's wall
    changed = differing(before, facts(env))
    assert {"episode.steps", "episode.events", "episode.frame", "simulation.in_play", "gravcomp", "random"} <= changed
    assert "stop" in changed
    env.restore(snapshot)
    assert differing(before, facts(env)) <= {"judge._tray", "judge._bin"}  # copies of boxes that nobody changes
    env.events.clear()  # a copy
    assert len(env.events) == env.delivered == 1


def test_the_judge_goes_on_where_it_was(env: BinPickEnv) -> None:
    """A part at rest in the tray is judged when it would have been, not a little later."""
    env.simulation.place(0, above_tray(env.simulation))
    steps = 0
    while env._judge._still[0] < 0.06:
        env.step(REST)
        steps += 1
        assert steps < 50
    snapshot = env.snapshot()

    def until_judged() -> int:
        steps = 0
        while env.delivered == 0:
            env.step(REST)
            steps += 1
            assert steps < 50
        return steps

    first = until_judged()
    env.restore(snapshot)
    assert until_judged() == first


def test_the_arms_way_home_is_remembered(env: BinPickEnv) -> None:
    """A frame is taken on return although the arm had left before the snapshot."""
    act(env, 0.8, np.append(HOME - [0.5, 0, 0, 0, 0, 0], 0.0).astype(np.float32))
    snapshot, frame_id = env.snapshot(), env.frame_id
    act(env, 0.8)
    assert env.frame_id == frame_id + 1
    env.restore(snapshot)
    assert env.frame_id == frame_id
    act(env, 0.8)
    assert env.frame_id == frame_id + 1


@pytest.mark.slow
def test_snapshots_of_another_cell_are_refused(env: BinPickEnv) -> None:
    snapshot = env.snapshot()
    narrow = CellConfig(bin=BinConfig(inner_size=(0.3, 0.2, 0.1)))
    for options, reason in [
        ({"num_parts": 4}, r"parts: 3 there, 4 here; model: \d+ there, \d+ here"),
        ({"part": "part_a"}, "part: tee there, part_a here"),
        ({"config": narrow}, r"bin: BinConfig\(inner_size=\(0.36, 0.26, 0.12\).*\) there, .*\(0.3, 0.2, 0.1\)"),
    ]:
        other = small_env(**options)
        other.reset(seed=2)
        before = facts(other)
        with pytest.raises(ValueError, match=rf"the snapshot is of another cell \({reason}"):
            other.restore(snapshot)
        assert differing(before, facts(other)) == set()
    with pytest.raises(ValueError, match=r"parts: 3 there, 2 here"):
        small_simulation(2, env.config).restore(snapshot.simulation)


def test_there_is_no_state_before_the_first_reset() -> None:
    with pytest.raises(RuntimeError, match=r"there is no frame before the first reset\(\)"):
        small_env().snapshot()


@pytest.mark.parametrize("take", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_snapshot_stays_where_it_was_taken(env: BinPickEnv, take: Callable[[object], object]) -> None:
    with pytest.raises(TypeError, match="belongs to the process that took it"):
        take(env.snapshot().simulation)


def test_a_part_of_the_same_name_is_another(tmp_path: Path) -> None:
    cells = []
    for folder, size in (("a", (0.06, 0.03, 0.03)), ("b", (0.05, 0.03, 0.02))):
        path = tmp_path / folder / "block.stl"
        path.parent.mkdir()
        trimesh.creation.box(size).export(path)
        cells.append(Simulation(CellConfig(), load_part(str(path)), 1))
    assert cells[0].part.model.name == cells[1].part.model.name
    with pytest.raises(ValueError, match=r"the snapshot is of another cell \(.*shapes: \w+ there, \w+ here"):
        cells[1].restore(cells[0].snapshot())
    cells[0].restore(cells[0].snapshot())
