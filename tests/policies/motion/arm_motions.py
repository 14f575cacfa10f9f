"""Postures, tools and a pile for the tests of motion."""

import numpy as np

from binpick_env.cell.robot import HOME
from binpick_env.config import CONTROL_PERIOD, RobotConfig
from perception.geometry import make_transform

LIMITS = RobotConfig()
DOWN = np.diag([1.0, -1.0, -1.0])
JAW = np.array([[x, y, z] for x in (-0.011, 0.011) for y in (-0.06, 0.06) for z in (-0.03, 0.005)])
PART = np.array([[x, y, z] for x in (-0.04, 0, 0.04) for y in (-0.015, 0.015) for z in (0.0, 0.035)])


def posture(ik, position):
    result = ik.solve(make_transform(DOWN, position), HOME)
    assert result.ok
    return result.q


def pile(points_world):
    over_bin = (np.abs(points_world[:, 0] - 0.5) < 0.13) & (np.abs(points_world[:, 1]) < 0.18)
    return np.where(over_bin, 0.10, -1.0)


def rates(trajectory):
    """Largest velocity and acceleration by finite differences, at rest before and after."""
    at_rest = np.vstack([trajectory.q[:1], trajectory.q, trajectory.q[-1:]])
    velocity = np.diff(at_rest, axis=0) / CONTROL_PERIOD
    return np.abs(velocity).max(), np.abs(np.diff(velocity, axis=0)).max() / CONTROL_PERIOD


def assert_obeys(trajectory, scale=1.0):
    velocity, acceleration = rates(trajectory)
    assert velocity <= scale * LIMITS.max_velocity
    assert np.abs(trajectory.qd).max() <= scale * LIMITS.max_velocity
    assert acceleration <= scale * LIMITS.max_acceleration
