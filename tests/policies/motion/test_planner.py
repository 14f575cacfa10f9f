"""The planner that chains inverse kinematics, paths and timing."""

import numpy as np
import pytest

from binpick_env.cell.robot import HOME
from perception.geometry import make_transform
from policies.motion.ik import IkSolver
from policies.motion.ik_settings import IkSettings
from policies.motion.path_checker import PathChecker
from policies.motion.planner import MotionPlanner, PlanFailure, PlannerSettings, StraightLegs, Tool
from policies.motion.planning_scene import MAX_CLEARANCE
from tests.policies.motion.arm_motions import DOWN, JAW, LIMITS, PART, assert_obeys, pile


def test_approach_is_one_motion_with_a_straight_end(planner, ik, q_grasp):
    legs = StraightLegs(standoff=0.08, speed=0.5)
    plan = planner.plan_transfer(HOME, q_grasp, Tool(points_tcp=JAW), legs, obstacle_height=pile)
    assert plan.ok
    trajectory = plan.trajectory
    assert_obeys(trajectory)
    np.testing.assert_array_equal(trajectory.q[-1], q_grasp)
    assert trajectory.duration < 1.2
    lifted, before_goal, goal = trajectory.marks
    assert lifted == 0
    assert goal == len(trajectory.t) - 1
    tips = np.array([ik.tcp_pose(q)[:3, 3] for q in trajectory.q[before_goal:]])
    assert np.linalg.norm(tips[:, :2] - tips[-1, :2], axis=1).max() < 1e-3
    assert 0.04 < tips[0, 2] - tips[-1, 2] <= 0.081
    assert np.abs(trajectory.qd[before_goal]).max() > 0.05  # passes the pre-grasp without a stop


def test_carry_lifts_straight_up_and_clears_the_rim(planner, ik, q_grasp, q_tray):
    tool = Tool(opening=0.03, points_tcp=np.vstack([JAW, PART]))
    lift = planner.clearing_lift(q_grasp, tool)
    assert lift == pytest.approx(0.14 + 0.02 - (0.06 - 0.035), abs=2e-3)
    plan = planner.plan_transfer(q_grasp, q_tray, tool, StraightLegs(lift=lift), obstacle_height=pile, scale=0.8)
    assert plan.ok
    assert_obeys(plan.trajectory, 0.8)
    poses = np.array([ik.tcp_pose(q) for q in plan.trajectory.q])
    up = poses[: plan.trajectory.marks[0], :3, 3]
    assert np.linalg.norm(up[:, :2] - up[0, :2], axis=1).max() < 1e-3
    points = np.einsum("sij,pj->spi", poses[:, :3, :3], tool.points_tcp) + poses[:, None, :3, 3]
    over_rim = (points[..., 1] < -0.18) & (points[..., 1] > -0.20) & (np.abs(points[..., 0] - 0.5) < 0.15)
    assert not np.any(over_rim & (points[..., 2] < 0.14))


def test_via_points_lead_around_an_obstacle(planner, scene, q_tray):
    """A pole of the pile's making stands between home and the tray, higher than the direct way."""

    def ridge(points_world):
        between = np.abs(points_world[:, 1] + 0.25) < 0.02
        return np.where(between, 0.30, -1.0)

    q_bin = IkSolver(scene).solve(make_transform(DOWN, (0.45, 0.0, 0.22)), HOME).q
    tool = Tool(points_tcp=JAW)
    assert planner.plan_transfer(q_bin, q_tray, tool).ok
    plan = planner.plan_transfer(q_bin, q_tray, tool, obstacle_height=ridge)
    assert plan.ok
    flat = PathChecker(scene).check(plan.trajectory.q, points_tcp=JAW, obstacle_height=ridge)
    assert flat.free


def test_failures_have_reasons(planner, scene, ik, q_grasp, q_tray, monkeypatch):
    tool = Tool(points_tcp=JAW)
    blocked = planner.plan_transfer(HOME, q_tray, tool, obstacle_height=lambda points: np.full(len(points), 2.0))
    assert blocked.failure is PlanFailure.COLLISION
    assert "no way across" in blocked.detail
    assert not blocked.ok
    far = planner.plan_transfer(HOME, q_grasp, tool, StraightLegs(lift=1.5))
    assert far.failure in (PlanFailure.IK, PlanFailure.JUMP)
    into_table = planner.plan_line(HOME, make_transform(DOWN, (0.3, -0.6, -0.03)), tool)
    assert into_table.failure is PlanFailure.COLLISION
    monkeypatch.setattr("policies.motion.planner.time_path", lambda *args, **kwargs: None)
    untimed = planner.plan_transfer(HOME, q_grasp, tool)
    assert untimed.failure is PlanFailure.INFEASIBLE_TIMING


def test_jump_is_told_apart(scene, ik):
    strict = MotionPlanner(scene, IkSolver(scene, IkSettings(max_jump=1e-3)))
    target = ik.tcp_pose(HOME) @ make_transform(translation=(0, 0, 0.05))
    assert strict.plan_line(HOME, target, Tool()).failure is PlanFailure.JUMP


def test_line_plan_goes_straight_at_the_speed_asked_for(planner, ik, q_grasp):
    up = make_transform(translation=(0, 0, 0.1)) @ ik.tcp_pose(q_grasp)
    fast, slow = (planner.plan_line(q_grasp, up, Tool(), speed=speed).trajectory for speed in (1.0, 0.1))
    assert fast.duration < slow.duration
    assert np.abs(slow.qd).max() <= 0.1 * LIMITS.max_velocity
    np.testing.assert_allclose(ik.tcp_pose(fast.q[-1])[:3, 3], up[:3, 3], atol=4e-4)


def test_a_line_keeps_its_clearance(planner, ik, scene):
    """A line that ends 1 mm over the table is refused, but for a planner that may come as near as that."""
    down = make_transform(DOWN, (0.2, -0.6, 0.02))
    q = ik.solve(down, HOME, opening=0.0).q
    down[2, 3] += 0.001 - scene.contacts(q, opening=0.0, clearance=MAX_CLEARANCE)[0].distance
    q_above = ik.solve(make_transform(translation=(0, 0, 0.05)) @ down, HOME, opening=0.0).q
    assert planner.plan_line(q_above, down, Tool(opening=0.0)).failure is PlanFailure.COLLISION
    assert (
        MotionPlanner(scene, ik, PlannerSettings(line_clearance=0.0002)).plan_line(q_above, down, Tool(opening=0.0)).ok
    )


def test_a_jaw_pressed_softly_into_the_floor_can_leave(planner, ik, scene):
    q = ik.solve(make_transform(DOWN, (0.5, 0.0, 0.023)), HOME).q
    assert -0.004 < scene.contacts(q)[0].distance < 0
    up = make_transform(translation=(0, 0, 0.05)) @ ik.tcp_pose(q)
    assert planner.plan_line(q, up, Tool()).failure is PlanFailure.COLLISION
    assert planner.plan_line(q, up, Tool(), escaping=True).ok
    assert planner.plan_transfer(q, HOME, Tool(), StraightLegs(lift=0.2)).ok


def test_bad_requests_are_refused(planner):
    with pytest.raises(ValueError, match="lift and standoff must be at least 0"):
        StraightLegs(lift=-0.1)
    with pytest.raises(ValueError, match=r"lift and standoff must be at least 0, got 0\.0 and -0\.05"):
        StraightLegs(standoff=-0.05)
    with pytest.raises(ValueError, match="q_to must be finite"):
        planner.plan_transfer(HOME, np.full(6, np.nan), Tool())
    with pytest.raises(ValueError, match=r"points_tcp must be \(N, 3\)"):
        Tool(points_tcp=np.zeros((3, 2)))
    with pytest.raises(ValueError, match="via_heights"):
        PlannerSettings(via_heights=(-0.1,))
    with pytest.raises(ValueError, match=r"line_speed must be in \(0, 1\], got 0"):
        PlannerSettings(line_speed=0)
