"""Cells that are quick to make and to look at, and what their tests do to them by hand."""

from typing import Any

import gymnasium as gym
import mujoco
import numpy as np

from binpick_env.cell.robot import HOME
from binpick_env.cell.simulation import Simulation
from binpick_env.config import CONTROL_PERIOD, CameraConfig, CellConfig
from binpick_env.env import BinPickEnv
from binpick_env.parts import load_part
from perception.geometry import Floats, make_transform, rotation_about

Step = tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]
CAMERA = CameraConfig(width=160, height=120)
# Its pixels are too few to be perceived; seeing_cell.py has those with more.
SMALL: dict[str, Any] = {"num_parts": 3, "camera": CAMERA, "threads": 1, "perception": "oracle"}
REST = np.append(HOME, 0.0).astype(np.float32)


def small_env(**arguments: Any) -> BinPickEnv:
    """Return a cell with three tees and a camera of few pixels."""
    return BinPickEnv(**SMALL | arguments)


def small_simulation(capacity: int = 3, config: CellConfig | None = None) -> Simulation:
    """Return a cell with room for a few tees, all of them parked."""
    return Simulation(config or CellConfig(), load_part("tee"), capacity)


def above_tray(simulation: Simulation, x: float = 0.0, y: float = 0.0, z: float = 0.05) -> Floats:
    """Return the pose of a part that lies flat, its centre at x, y, z from the middle of the tray's floor."""
    tray = simulation.config.tray
    return centred(simulation, (tray.position[0] + x, tray.position[1] + y, tray.wall + z))


def centred(simulation: Simulation, centre_world: tuple[float, float, float], angle: float = 0.0) -> Floats:
    """Return the pose of a part whose centre is at a place, turned by ``angle`` about the world's x axis."""
    turn = rotation_about((1, 0, 0), angle)
    return make_transform(turn, np.asarray(centre_world) - turn @ simulation.part.model.centre)


def wait(simulation: Simulation, seconds: float, targets: Floats = HOME, gripper: float = 0.0) -> None:
    """Hold targets for a while."""
    for _ in range(round(seconds / CONTROL_PERIOD)):
        simulation.step(targets, gripper)


def deepest_overlap(simulation: Simulation) -> float:
    """Return MuJoCo's largest penetration [m] with every body awake: sleeping pairs are not looked at."""
    awake = mujoco.MjData(simulation.model)
    awake.qpos = simulation.data.qpos
    flags = simulation.model.opt.enableflags
    simulation.model.opt.enableflags = flags & ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    mujoco.mj_forward(simulation.model, awake)
    simulation.model.opt.enableflags = flags
    assert awake.ncon > 3 * simulation.in_play.sum()
    return -float(awake.contact.dist.min())


def grip(simulation: Simulation, i: int, width: float = 0.02) -> None:
    """Put part ``i`` between the fingers of the resting arm and close them until it is squeezed."""
    T_tcp_part = make_transform(translation=-simulation.part.model.centre)
    for _ in range(round(1.0 / CONTROL_PERIOD)):
        simulation.place(i, simulation.T_world_tcp @ T_tcp_part)
        simulation.step(simulation.target, 1.0)
        if simulation.gripped():
            break
    wait(simulation, 0.4, simulation.target, 1.0)


def act(env: gym.Env[Any, Any], seconds: float, action: np.ndarray = REST) -> list[Step]:
    return [env.step(action) for _ in range(round(seconds * 25))]  # type: ignore[misc]


def random_actions(env: BinPickEnv, count: int, seed: int = 5) -> list[np.ndarray]:
    env.action_space.seed(seed)
    return [env.action_space.sample() for _ in range(count)]


def assert_same(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> None:
    assert first.keys() == second.keys()
    for key in first:
        np.testing.assert_array_equal(first[key], second[key], err_msg=key)
