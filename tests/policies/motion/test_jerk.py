"""Timing of joint paths within a limit of jerk."""

from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from toppra import SplineInterpolator

from binpick_env.cell.robot import HOME
from binpick_env.config import CONTROL_PERIOD, CellConfig, RobotConfig
from policies.motion.planner import MotionPlanner, StraightLegs, Tool
from policies.motion.trajectory import join, leg, smooth_path, time_path
from tests.policies.motion.arm_motions import JAW, LIMITS

FINE = 0.001  # period of samples whose differences are compared with the limits [s]


def curved(seed, speed=1.0):
    """A path over two random waypoints, whose second leg has another share of the velocity limit."""
    rng = np.random.default_rng(seed)
    waypoints = HOME + np.vstack([np.zeros(6), rng.uniform(-0.7, 0.7, (2, 6))])
    fast = smooth_path(waypoints)
    end = waypoints[-1] + rng.uniform(-0.3, 0.3, 6)
    slow = smooth_path(np.vstack([waypoints[-1], end]), tangent_from=fast[-1] - fast[-2])
    return join([leg(fast), leg(slow, speed)])


def timed(path, jerk, **options):
    return time_path(path, replace(LIMITS, max_jerk=jerk), **({"period": FINE} | options))


def assert_limited(trajectory, jerk, scale=1.0, speed=1.0):
    """Differences of positions are means of the derivatives; at rest before and after, so that both ends count."""
    rest = np.ones((3, 1))
    values = np.vstack([rest * trajectory.q[0], trajectory.q, rest * trajectory.q[-1]])
    for limit in (LIMITS.max_velocity, LIMITS.max_acceleration, jerk):
        values = np.diff(values, axis=0) / FINE
        assert np.abs(values).max() <= scale * limit
    assert np.abs(trajectory.qd[trajectory.marks[0] :]).max() <= scale * speed * LIMITS.max_velocity
    np.testing.assert_array_equal(trajectory.qd[[0, -1]], 0.0)


def distance_to(path, q):
    """Largest distance of samples from a path's curve, by chords of 1e-3 rad; their sagitta is under 1e-5 rad."""
    moves = np.concatenate([[True], np.linalg.norm(np.diff(path.q, axis=0), axis=1) > 1e-6])
    knots = path.q[moves]
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
    dense = SplineInterpolator(s, knots)(np.linspace(0, s[-1], int(s[-1] / 1e-3)))
    starts, chords = dense[:-1], np.diff(dense, axis=0)
    since = q[:, None] - starts
    along = np.clip(np.sum(since * chords, axis=-1) / np.sum(chords**2, axis=-1), 0, 1)
    return np.linalg.norm(since - along[..., None] * chords, axis=-1).min(axis=1).max()


@pytest.mark.parametrize("jerk", [200.0, 40.0])
@pytest.mark.parametrize("seed", range(4))
def test_limits_hold_everywhere_and_the_path_is_kept(seed, jerk):
    path = curved(seed, speed=0.5)
    trajectory = timed(path, jerk)
    assert_limited(trajectory, jerk, speed=0.5)
    np.testing.assert_array_equal(trajectory.q[[0, -1]], path.q[[0, -1]])
    assert distance_to(path, trajectory.q[:: len(trajectory.q) // 60]) < 2e-5


def test_scale_slows_everything():
    assert_limited(timed(curved(5), 100.0, scale=0.5), 100.0, scale=0.5)


def test_time_falls_to_that_without_a_limit_of_jerk():
    path = curved(6)
    times = [timed(path, jerk).duration for jerk in (10.0, 50.0, 250.0, 1250.0, 1e5, None)]
    assert np.all(np.diff(times[:-1]) < 0.002)
    assert times[0] > 2 * times[-1]
    assert times[-1] < times[-2] < 1.02 * times[-1]  # without one, limits may be passed a little between grid points


def seven_segments(way, velocity, acceleration, jerk):
    """Time of the fastest move of one joint from rest to rest within three limits, in closed form.

    The acceleration rises, stays and falls, and mirrored again, with a cruise in between; what the way is too short
    for is left out.
    """
    peak = min(velocity, np.sqrt(way * acceleration + (acceleration**2 / jerk / 2) ** 2) - acceleration**2 / jerk / 2)
    if peak < acceleration**2 / jerk:  # the acceleration does not reach its limit
        peak = min(velocity, np.cbrt(way**2 * jerk / 4))
        ramp = 2 * np.sqrt(peak / jerk)
    else:
        ramp = peak / acceleration + acceleration / jerk
    return way / peak + ramp


@pytest.mark.parametrize("jerk", [100.0, 25.0])
@pytest.mark.parametrize("way", [0.05, 0.3, 1.0, 2.5])
def test_a_move_of_one_joint_is_nearly_as_fast_as_can_be(way, jerk):
    move = np.array([way, 0, 0, 0, 0, 0])
    trajectory = timed(leg(smooth_path(np.vstack([HOME, HOME + move]))), jerk)
    best = seven_segments(way, LIMITS.max_velocity, LIMITS.max_acceleration, jerk)
    assert best < trajectory.duration < 1.14 * best


def test_samples_are_control_periods_and_marks_are_ends_of_legs():
    path = curved(7, speed=0.4)
    trajectory = timed(path, 60.0, period=CONTROL_PERIOD)
    np.testing.assert_allclose(np.diff(trajectory.t), CONTROL_PERIOD)
    first, last = trajectory.marks
    assert last == len(trajectory.t) - 1
    gap = path.q[path.ends[0]] - trajectory.q[first - 1 : first + 1]
    ahead = trajectory.qd[first] / np.linalg.norm(trajectory.qd[first])
    assert gap[0] @ ahead > 0 >= gap[1] @ ahead - 1e-5  # the sample before is before it, this one at or after it
    step = 0.4 * LIMITS.max_velocity * CONTROL_PERIOD
    np.testing.assert_allclose(trajectory.q[first], path.q[path.ends[0]], atol=step)


def test_short_paths_are_timed_as_well():
    for knots in (np.vstack([HOME, HOME + 1e-3]), np.vstack([HOME, HOME + 0.1, HOME + 0.2]), HOME[None]):
        trajectory = timed(leg(knots), 50.0)
        assert_limited(trajectory, 50.0)
        np.testing.assert_array_equal(trajectory.q[[0, -1]], knots[[0, -1]])


def test_limits_hold_where_the_linear_programs_fail(monkeypatch):
    monkeypatch.setattr("policies.motion.jerk.linprog", lambda *args, **kwargs: SimpleNamespace(x=None))
    trajectory = timed(curved(8), 100.0)
    assert_limited(trajectory, 100.0)


def test_planned_motions_obey_the_cells_limits(scene, ik, q_grasp):
    limited = copy(scene)
    limited.config = CellConfig(robot=RobotConfig(max_acceleration=4.0, max_jerk=30.0))
    legs, tool = StraightLegs(standoff=0.1, speed=0.5), Tool(points_tcp=JAW)
    plans = [MotionPlanner(each, ik).plan_transfer(HOME, q_grasp, tool, legs) for each in (scene, limited)]
    values = plans[1].trajectory.q
    values = np.vstack([values[[0, 0]], values, values[[-1, -1]]])
    most = [np.abs(np.diff(values, n, axis=0)).max() / CONTROL_PERIOD**n for n in (2, 3)]
    assert most[0] <= 4.0
    assert most[1] <= 30.0
    assert plans[1].trajectory.duration > 1.3 * plans[0].trajectory.duration
    again = MotionPlanner(limited, ik).plan_transfer(HOME, q_grasp, tool, legs)
    assert again.trajectory.q.tobytes() == plans[1].trajectory.q.tobytes()
