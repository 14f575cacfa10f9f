"""Timing of joint paths, collision checks and the planner that chains them."""

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from binpick_env.cell.robot import HOME
from binpick_env.config import CONTROL_PERIOD, CellConfig, RobotConfig
from perception.geometry import make_transform, rotation_about
from policies.motion.ik import IkSolver
from policies.motion.ik_settings import IkSettings
from policies.motion.path_checker import PathChecker
from policies.motion.planner import MotionPlanner, PlanFailure, PlannerSettings, StraightLegs, Tool
from policies.motion.planning_scene import MAX_CLEARANCE, PlanningScene
from policies.motion.trajectory import JointPath, join, leg, smooth_path, time_path

LIMITS = RobotConfig()
DOWN = np.diag([1.0, -1.0, -1.0])
JAW = np.array([[x, y, z] for x in (-0.011, 0.011) for y in (-0.06, 0.06) for z in (-0.03, 0.005)])
PART = np.array([[x, y, z] for x in (-0.04, 0, 0.04) for y in (-0.015, 0.015) for z in (0.0, 0.035)])


@pytest.fixture(scope="module")
def scene():
    return PlanningScene()


@pytest.fixture(scope="module")
def ik(scene):
    return IkSolver(scene)


@pytest.fixture(scope="module")
def planner(scene, ik):
    return MotionPlanner(scene, ik)


@pytest.fixture(scope="module")
def q_grasp(ik):
    return posture(ik, (0.48, 0.05, 0.06))


@pytest.fixture(scope="module")
def q_tray(ik):
    return posture(ik, (0.42, -0.42, 0.15))


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


joint_moves = st.lists(st.floats(-2.5, 2.5), min_size=6, max_size=6).map(np.array)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(move=joint_moves)
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


# --- collisions


def distance_by_mujoco(scene, q):
    """Smallest mj_geomDistance between any robot geom that may touch the cell and any of the cell's."""
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[:6] = q
    mujoco.mj_forward(model, data)
    still = model.body_weldid[model.geom_bodyid] == 0
    pairs = [
        (a, b)
        for a in np.flatnonzero(~still)
        for b in np.flatnonzero(still)
        if model.geom_conaffinity[a] & model.geom_contype[b]
        and not (model.geom(b).name == "arm_base" and model.body(model.geom_bodyid[a]).name == "upper_arm_link")
    ]
    return min(mujoco.mj_geomDistance(model, data, a, b, 0.5, None) for a, b in pairs)


def test_contacts_agree_with_mujocos_distances(scene, ik):
    rng = np.random.default_rng(4)
    verdicts = []
    for _ in range(60):
        q = ik.solve(make_transform(DOWN, rng.uniform((0.3, -0.25, 0.0), (0.7, 0.25, 0.25))), HOME).q
        distance = distance_by_mujoco(scene, q)
        touches = [c for c in scene.contacts(q, clearance=0.01) if not _self_contact(c)]
        if abs(distance - 0.01) > 1e-4:
            assert bool(touches) == (distance < 0.01)
        verdicts.append(distance < 0.01)
    assert 5 < sum(verdicts) < 55


def _self_contact(contact):
    cell = ("bin/", "tray/", "table", "pedestal", "arm_base")
    return not (contact.first.startswith(cell) or contact.second.startswith(cell))


def test_checker_flags_a_posture_in_the_wall_and_passes_a_free_one(scene, ik):
    checker = PathChecker(scene)
    closing_along_x = DOWN @ rotation_about((0, 0, 1), np.pi / 2)  # or the open jaw would stand astride the wall
    inside = ik.solve(make_transform(closing_along_x, (0.5, 0.19, 0.10)), HOME).q
    assert distance_by_mujoco(scene, inside) < 0
    assert checker.check(HOME[None]).free
    verdict = checker.check(np.vstack([HOME, inside]))
    assert not verdict.free
    assert "bin/" in verdict.reason


def test_checker_sees_between_the_knots(scene, ik):
    """Both ends of this path are free, but the way between leads through the bin's wall."""
    q_in, q_out = posture(ik, (0.5, 0.0, 0.06)), posture(ik, (0.5, -0.30, 0.06))
    checker = PathChecker(scene)
    assert checker.check(q_in[None]).free
    assert checker.check(q_out[None]).free
    assert not checker.check(np.vstack([q_in, q_out])).free


def test_arm_folded_into_itself_is_a_collision(scene):
    folded = np.array([0.0, -1.2, 2.9, -np.pi / 2, -np.pi / 2, 0.0])
    assert any(_self_contact(contact) for contact in scene.contacts(folded))


def test_carried_points_must_clear_rim_and_pile(scene, ik):
    checker = PathChecker(scene)
    over_wall = posture(ik, (0.5, 0.185, 0.19))[None]  # the rim is at 0.14
    hanging = np.array([[0.0, 0.0, 0.045]])
    assert checker.check(over_wall, points_tcp=hanging).free
    assert not checker.check(over_wall, points_tcp=hanging, pile_clearance=0.01).free
    over_pile = posture(ik, (0.5, 0.0, 0.16))[None]
    assert checker.check(over_pile, points_tcp=hanging).free
    low = checker.check(over_pile, points_tcp=hanging, obstacle_height=lambda points: np.full(len(points), 0.12))
    assert not low.free
    assert "-5.0 mm above the surface" in low.reason


def test_static_height_is_that_of_the_boxes(scene):
    points = np.array([[0.5, 0, 1], [0.5, 0.185, 1], [0.5, -0.185, 1], [0.365, 0, 1], [0.42, -0.42, 1], [0.0, 0.4, 1]])
    np.testing.assert_allclose(scene.static_height(points), [0.02, 0.14, 0.14, 0.14, 0.01, 0.0], atol=1e-12)
    assert scene.static_height(np.array([[9.0, 9.0, 0.0]]))[0] == -np.inf


def test_tcp_poses_are_read_anew_and_belong_to_the_caller(scene, monkeypatch):
    """No view of the simulation's data outlives a placement, and no later query changes a returned pose."""
    q = np.vstack([HOME, HOME + 0.1, HOME - 0.2])
    poses = scene.tcp_poses(q)
    before = poses.copy()
    scene.contacts(HOME + 0.3)
    np.testing.assert_array_equal(poses, before)
    place = PlanningScene._place

    def place_in_new_data(self, posture, opening):
        self._data = mujoco.MjData(self.model)
        place(self, posture, opening)

    monkeypatch.setattr(PlanningScene, "_place", place_in_new_data)
    np.testing.assert_array_equal(scene.tcp_poses(q), before)


def test_refined_path_moves_the_tip_in_small_steps(scene):
    checker = PathChecker(scene)
    samples = checker.refine(np.vstack([HOME, HOME + np.array([0.8, 0, 0, 0, 0, 0])]))
    tips = scene.tcp_poses(samples)[:, :3, 3]
    assert np.linalg.norm(np.diff(tips, axis=0), axis=1).max() < 0.025


@pytest.mark.parametrize("opening", [0.0, 0.02, 0.05, 0.085])
def test_jaw_posture_opens_as_asked(scene, opening):
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[6:] = scene.jaw_posture(opening)
    mujoco.mj_kinematics(model, data)
    left, right = model.geom("gripper/left_pad1").id, model.geom("gripper/right_pad1").id
    assert mujoco.mj_geomDistance(model, data, left, right, 0.2, None) == pytest.approx(opening, abs=1e-3)


def test_a_limited_jaw_opens_no_wider():
    narrow = PlanningScene(CellConfig(robot=RobotConfig(jaw=0.05)))
    assert narrow.max_opening == 0.05
    np.testing.assert_array_equal(narrow.jaw_posture(0.08), narrow.jaw_posture(0.05))
    q = HOME.copy()
    narrow.contacts(q)  # the open jaw's shapes are those of 50 mm
    left, right = (narrow.model.geom(f"gripper/{side}_pad1").id for side in ("left", "right"))
    opening = mujoco.mj_geomDistance(narrow.model, narrow._data, left, right, 0.2, None)
    assert opening == pytest.approx(0.05, abs=1e-3)


def test_a_closed_jaw_fits_where_an_open_one_does_not(scene, ik):
    """The tips reach 2 cm below the rim, 3.5 cm from the wall that the jaw opens towards."""
    q = ik.solve(make_transform(DOWN, (0.5, 0.145, 0.12)), HOME).q
    assert scene.contacts(q)
    assert not scene.contacts(q, opening=0.0)


def test_a_single_contact_is_reported(scene, ik):
    """Only one pad of a tilted, closed jaw comes within the largest clearance of the table."""
    tilted = rotation_about((1, 0, 0), 0.3) @ rotation_about((0, 1, 0), 0.2) @ DOWN
    q = ik.solve(make_transform(tilted, (0.35, -0.6, 0.05)), HOME, opening=0.0).q
    (contact,) = scene.contacts(q, opening=0.0, clearance=MAX_CLEARANCE)
    assert {contact.first, contact.second} == {"table", "gripper/right_pad1"}
    assert contact.distance == pytest.approx(0.029, abs=5e-4)
    assert contact.gripper_on_cell


def test_clearance_beyond_what_is_modelled_is_refused(scene):
    with pytest.raises(ValueError, match="clearance must be in"):
        scene.contacts(HOME, clearance=MAX_CLEARANCE + 0.01)
    with pytest.raises(ValueError, match="clearance must be in"):
        scene.contacts(HOME, clearance=-MAX_CLEARANCE - 0.01)


# --- plans


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
