"""Timing of joint paths."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from binpick_env.cell.robot import HOME
from binpick_env.config import CONTROL_PERIOD
from policies.motion.planner import StraightLegs, Tool
from policies.motion.trajectory import JointPath, join, leg, smooth_path, time_path
from tests.policies.motion.arm_motions import JAW, LIMITS, assert_obeys

joint_moves = st.lists(st.floats(-2.5, 2.5), min_size=6, max_size=6).map(np.array)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(move=joint_moves)
@example(move=np.zeros(6))
@example(move=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1e-9]))
@example(move=np.array([0.0, 0.0, 2e-6, 0.0, 0.0, 1e-9]))
def test_straight_joint_move_obeys_limits_ends_exactly_and_never_turns_back(move):
    trajectory = time_path(leg(smooth_path(np.vstack([HOME, HOME + move]))), LIMITS)
    assert trajectory is not None
    np.testing.assert_array_equal(trajectory.q[0], HOME)
    np.testing.assert_array_equal(trajectory.q[-1], HOME + move)
    np.testing.assert_array_equal(trajectory.qd[[0, -1]], 0.0)
    np.testing.assert_allclose(np.diff(trajectory.t), CONTROL_PERIOD)
    assert np.all(np.diff(trajectory.q, axis=0) * np.sign(move) >= -1e-9)  # no overshoot
    assert_obeys(trajectory)


def test_duration_is_that_of_the_trapezoid():
    """One joint by 2 rad: accelerate to v, cruise, brake: d / v + v / a."""
    move = np.array([2.0, 0, 0, 0, 0, 0])
    trajectory = time_path(leg(smooth_path(np.vstack([HOME, HOME + move]))), LIMITS)
    ideal = 2.0 / LIMITS.max_velocity + LIMITS.max_velocity / LIMITS.max_acceleration
    assert ideal <= trajectory.duration <= 1.05 * ideal + CONTROL_PERIOD


@pytest.mark.parametrize("scale", [1.0, 0.6, 0.25])
def test_scale_slows_everything(scale):
    path = leg(smooth_path(np.vstack([HOME, HOME + np.array([1, -0.3, 0.4, 0.2, 0.1, -1.4])])))
    assert_obeys(time_path(path, LIMITS, scale=scale), scale)


def test_a_slow_leg_is_slow_and_marked():
    middle, end = HOME + 0.6, HOME + 0.9
    fast, slow = leg(smooth_path(np.vstack([HOME, middle]))), leg(smooth_path(np.vstack([middle, end])), 0.2)
    trajectory = time_path(join([fast, slow]), LIMITS)
    first, last = trajectory.marks
    assert last == len(trajectory.t) - 1
    np.testing.assert_allclose(trajectory.q[first], middle, atol=0.2 * LIMITS.max_velocity * CONTROL_PERIOD)
    assert np.abs(trajectory.qd[first:]).max() <= 0.2 * LIMITS.max_velocity
    assert np.abs(trajectory.qd[:first]).max() > 0.4 * LIMITS.max_velocity
    assert np.abs(trajectory.qd[first]).max() > 0.1 * LIMITS.max_velocity  # no stop in between


def test_smooth_path_passes_its_waypoints_and_takes_up_its_tangents():
    rng = np.random.default_rng(2)
    waypoints = HOME + np.vstack([np.zeros(6), rng.uniform(-0.5, 0.5, (3, 6))])
    tangent = np.array([0, 0, 0, 0, 0, 1.0])
    knots = smooth_path(waypoints, tangent_from=tangent)
    for waypoint in waypoints:
        assert np.abs(knots - waypoint).max(axis=1).min() < 1e-12
    start = knots[1] - knots[0]
    assert start @ tangent / np.linalg.norm(start) > 0.9


def test_path_without_motion_is_one_sample():
    trajectory = time_path(join([leg(HOME[None]), leg(HOME[None])]), LIMITS)
    assert trajectory.duration == 0.0
    assert trajectory.marks == (0, 0)
    np.testing.assert_array_equal(trajectory.q, HOME[None])
    assert len(smooth_path(np.vstack([HOME, HOME]))) == 1


def test_repeated_knots_do_no_harm():
    once = smooth_path(np.vstack([HOME, HOME + 0.4]))
    twice = time_path(leg(np.repeat(once, 2, axis=0)), LIMITS)
    np.testing.assert_allclose(twice.q, time_path(leg(once), LIMITS).q)


def test_no_timing_is_none(monkeypatch):
    monkeypatch.setattr("toppra.algorithm.TOPPRA.compute_parameterization", lambda *args, **kwargs: (None, None, None))
    assert time_path(leg(smooth_path(np.vstack([HOME, HOME + 1]))), LIMITS) is None


def test_same_path_same_bits(planner, q_grasp):
    plans = [planner.plan_transfer(HOME, q_grasp, Tool(points_tcp=JAW), StraightLegs(standoff=0.1)) for _ in range(2)]
    assert plans[0].trajectory.q.tobytes() == plans[1].trajectory.q.tobytes()


def test_bad_paths_are_refused():
    with pytest.raises(ValueError, match="q must be finite"):
        leg(np.full((2, 6), np.nan))
    with pytest.raises(ValueError, match=r"q must be \(N, 6\)"):
        leg(np.zeros((2, 5)))
    with pytest.raises(ValueError, match=r"speed must be in \(0, 1\]"):
        leg(HOME[None], 1.5)
    with pytest.raises(ValueError, match=r"speed must be \(2,\)"):
        JointPath(q=np.zeros((2, 6)), speed=np.ones(3), ends=(1,))
    with pytest.raises(ValueError, match=r"got a gap of 1\.0000 rad"):
        join([leg(HOME[None]), leg(HOME[None] + 1)])
    with pytest.raises(ValueError, match="at least one path"):
        join([])
    with pytest.raises(ValueError, match="scale must be in"):
        time_path(leg(HOME[None]), LIMITS, scale=0.0)
    with pytest.raises(ValueError, match="period must be positive"):
        time_path(leg(HOME[None]), LIMITS, period=0.0)
    with pytest.raises(ValueError, match="a tangent must have a length"):
        smooth_path(np.vstack([HOME, HOME + 1]), tangent_from=np.zeros(6))
