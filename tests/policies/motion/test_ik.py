"""Inverse kinematics against MuJoCo's own forward kinematics."""

from dataclasses import replace

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from binpick_env.cell.robot import ARM_JOINTS, HOME, TCP_SITE
from binpick_env.cell.scene import cell_spec
from binpick_env.config import CellConfig
from perception.geometry import make_transform, rotation_about, rotation_angle
from policies.motion.differential_ik import HingeLimit
from policies.motion.ik import IkSolver
from policies.motion.ik_settings import IkSettings
from policies.motion.planning_scene import PlanningScene

DOWN = np.diag([1.0, -1.0, -1.0])
ABOVE_BIN = make_transform(DOWN, (0.5, 0.0, 0.25))


@pytest.fixture(scope="module")
def scene():
    return PlanningScene()


@pytest.fixture(scope="module")
def solver(scene):
    return IkSolver(scene)


@pytest.fixture(scope="module")
def full_cell():
    model = cell_spec(CellConfig()).compile()
    return model, mujoco.MjData(model)


def bin_pose(x, y, z, azimuth, tilt, yaw):
    rotation = rotation_about((np.cos(azimuth), np.sin(azimuth), 0), tilt) @ DOWN @ rotation_about((0, 0, 1), yaw)
    return make_transform(rotation, (0.5 + x, y, 0.02 + z))


def tcp_by_forward(full_cell, q):
    model, data = full_cell
    mujoco.mj_resetData(model, data)
    for name, value in zip(ARM_JOINTS, q, strict=True):
        data.joint(name).qpos = value
    mujoco.mj_forward(model, data)
    return make_transform(data.site(TCP_SITE).xmat.reshape(3, 3), data.site(TCP_SITE).xpos)


poses_in_bin = st.builds(
    bin_pose,
    st.floats(-0.13, 0.13),
    st.floats(-0.18, 0.18),
    st.floats(0.005, 0.12),
    st.floats(0, 2 * np.pi),
    st.floats(0, np.pi / 4),
    st.floats(-np.pi, np.pi),
)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(T_world_tcp=poses_in_bin)
def test_solution_puts_the_real_models_tcp_on_the_target(solver, full_cell, T_world_tcp):
    result = solver.solve(T_world_tcp, HOME)
    assert result.converged
    reached = tcp_by_forward(full_cell, result.q)
    assert np.linalg.norm(reached[:3, 3] - T_world_tcp[:3, 3]) <= 3e-4 + 1e-6
    assert rotation_angle(reached[:3, :3].T @ T_world_tcp[:3, :3]) <= 3e-3 + 1e-6
    assert result.position_error == pytest.approx(np.linalg.norm(reached[:3, 3] - T_world_tcp[:3, 3]), abs=1e-9)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(T_world_tcp=poses_in_bin)
def test_solutions_stay_within_limits_elbow_up_and_unwound(solver, scene, T_world_tcp):
    q = solver.solve(T_world_tcp, HOME).q
    assert np.all((q >= scene.limits[:, 0]) & (q <= scene.limits[:, 1]))
    assert q[2] > 0
    assert -np.pi < q[0] <= np.pi
    assert np.max(np.abs(q - HOME)) <= np.pi + 0.5


def test_nearly_every_pose_in_the_bin_converges(solver):
    rng = np.random.default_rng(11)
    low, high = (-0.13, -0.18, 0.005, 0, 0, -np.pi), (0.13, 0.18, 0.12, 2 * np.pi, np.pi / 4, np.pi)
    results = [solver.solve(bin_pose(*rng.uniform(low, high)), HOME) for _ in range(200)]
    assert np.mean([result.converged for result in results]) >= 0.98


def test_recovers_a_known_posture(solver):
    rng = np.random.default_rng(3)
    for _ in range(20):
        q = HOME + rng.uniform(-0.3, 0.3, 6)
        result = solver.solve(solver.tcp_pose(q), q + rng.normal(scale=0.02, size=6))
        np.testing.assert_allclose(result.q, q, atol=0.02)


def test_the_posture_itself_as_seed_needs_no_iteration(solver):
    result = solver.solve(solver.tcp_pose(HOME), HOME)
    assert result.ok
    assert result.iterations == 0
    np.testing.assert_array_equal(result.q, HOME)


def test_unreachable_target_is_a_value_with_its_residual(solver):
    result = solver.solve(make_transform(DOWN, (2.0, 0.0, 0.3)), HOME)
    assert not result.converged
    assert not result.ok
    assert 0.8 < result.position_error < 1.5
    assert np.all(np.isfinite(result.q))


def test_of_two_postures_off_the_target_the_nearer_one_is_better(solver):
    far = solver.solve(make_transform(DOWN, (2.0, 0.0, 0.3)), HOME)
    assert not far.converged
    for error in ("position_error", "rotation_error"):
        nearer = replace(far, **{error: getattr(far, error) - 0.01})
        assert solver._rank(nearer, HOME) < solver._rank(far, HOME)


def test_a_wound_up_seed_is_unwound(solver):
    seed = HOME + np.array([0, 0, 0, 0, 0, 2 * np.pi - HOME[5] - 0.5])
    wound = HOME.copy()
    wound[0] = -6.1
    for q_near in (seed, wound):
        result = solver.solve(ABOVE_BIN, q_near)
        assert result.ok
        assert -np.pi < result.q[0] <= np.pi


def test_several_seeds_the_first_says_what_near_means(solver):
    q = solver.solve(ABOVE_BIN, HOME).q
    result = solver.solve(ABOVE_BIN, np.vstack([q, HOME, HOME + 0.2]))
    np.testing.assert_allclose(result.q, q, atol=1e-9)


def test_pose_that_puts_the_jaw_into_a_wall_is_flagged(solver):
    result = solver.solve(bin_pose(0.0, 0.175, 0.03, 0, 0, 0), HOME)  # 5 mm from the wall, jaw open across
    assert result.converged
    assert result.collision
    assert result.gripper_collides
    assert any("bin/wall" in contact.first + contact.second for contact in result.contacts)


def test_the_joints_limit_is_minks_own(scene):
    """The faster one gives the same bits."""
    ours, theirs = HingeLimit(scene.arm_model), mink.ConfigurationLimit(scene.arm_model)
    rng, limits = np.random.default_rng(5), scene.limits
    for q in [HOME, limits[:, 0], *rng.uniform(limits[:, 0], limits[:, 1], (20, 6))]:
        configuration = mink.Configuration(scene.arm_model, q)
        (G, h), (G_mink, h_mink) = (limit.compute_qp_inequalities(configuration, 1.0) for limit in (ours, theirs))
        assert (G.tobytes(), h.tobytes()) == (G_mink.tobytes(), h_mink.tobytes())


def test_descent_with_collision_avoidance_keeps_its_distance(scene, solver):
    """The collision avoidance limit stops above the table where the free descent goes through it."""
    target = make_transform(DOWN, (0.2, -0.55, -0.04))
    free = solver.solve(target, HOME)
    assert free.converged
    assert free.collision
    q, _ = solver._differential.descend(mink.SE3.from_matrix(target), HOME, avoid_collisions=True)
    assert not scene.contacts(q)
    assert 0.0 < solver.tcp_pose(q)[2, 3] < 0.08


@settings(max_examples=30, deadline=None, derandomize=True)
@given(T_world_tcp=poses_in_bin)
def test_solve_grasp_keeps_the_grasp_and_turns_the_wrist_less(solver, T_world_tcp):
    result = solver.solve_grasp(T_world_tcp, HOME)
    reached = solver.tcp_pose(result.q)
    assert result.converged
    np.testing.assert_allclose(reached[:3, 2], T_world_tcp[:3, 2], atol=4e-3)
    assert abs(abs(reached[:3, 1] @ T_world_tcp[:3, 1]) - 1) < 1e-4


def test_solve_grasp_flips_the_jaw_where_that_is_shorter(solver):
    turned = ABOVE_BIN @ make_transform(rotation_about((0, 0, 1), np.pi))
    one, other = solver.solve_grasp(ABOVE_BIN, HOME), solver.solve_grasp(turned, HOME)
    np.testing.assert_allclose(one.q, other.q, atol=1e-3)
    assert np.abs(one.q - HOME).max() < np.pi / 2


def test_line_is_straight_and_level(solver):
    q_start = solver.solve(ABOVE_BIN, HOME).q
    goal = make_transform(rotation_about((1, 0, 0), 0.3) @ DOWN, (0.53, 0.05, 0.12))
    path = solver.line(q_start, goal)
    assert path.complete
    np.testing.assert_array_equal(path.q[0], q_start)
    fine = np.vstack([a + (b - a) * k / 4 for a, b in zip(path.q[:-1], path.q[1:], strict=True) for k in range(4)])
    tips = np.array([solver.tcp_pose(q)[:3, 3] for q in fine])
    direction = goal[:3, 3] - ABOVE_BIN[:3, 3]
    direction /= np.linalg.norm(direction)
    off = tips - ABOVE_BIN[:3, 3]
    assert np.linalg.norm(off - np.outer(off @ direction, direction), axis=1).max() < 1e-3
    assert np.abs(np.diff(path.q, axis=0)).max() < 0.35
    np.testing.assert_allclose(solver.tcp_pose(path.q[-1])[:3, 3], goal[:3, 3], atol=4e-4)


def test_line_out_of_reach_stops_and_says_so(solver):
    path = solver.line(HOME, make_transform(DOWN, (1.6, -0.4, 0.3)))
    assert not path.complete
    assert not path.jumped
    assert 1 < len(path.q) < 240


def test_line_with_a_tiny_jump_limit_reports_the_jump(scene):
    strict = IkSolver(scene, IkSettings(max_jump=1e-3))
    path = strict.line(HOME, strict.tcp_pose(HOME) @ make_transform(translation=(0, 0, 0.05)))
    assert path.jumped
    assert not path.complete


def test_line_of_no_length_is_its_start(solver):
    path = solver.line(HOME, solver.tcp_pose(HOME))
    assert path.complete
    np.testing.assert_array_equal(path.q[0], HOME)


def test_same_call_same_bits(scene, solver):
    target = bin_pose(0.05, -0.1, 0.04, 1.0, 0.5, 2.0)
    first = solver.solve(target, HOME)
    solver.solve(ABOVE_BIN, HOME + 0.1)
    for again in (solver.solve(target, HOME), IkSolver(scene).solve(target, HOME)):
        assert first.q.tobytes() == again.q.tobytes()
        assert first.iterations == again.iterations


def test_smallest_singular_value_vanishes_at_a_singularity(solver):
    straight_wrist = HOME.copy()
    straight_wrist[4] = 0.0
    assert solver._differential.min_singular_value(straight_wrist) < 1e-6
    assert solver._differential.min_singular_value(HOME) > 0.1


def test_home_is_free_unwound_and_far_from_limits_and_singularities(scene, solver):
    assert not scene.contacts(HOME, clearance=0.03)
    assert np.min(HOME - scene.limits[:, 0]) > 1.0
    assert np.min(scene.limits[:, 1] - HOME) > 1.0
    assert np.all(np.abs(HOME) < np.pi)
    assert solver._differential.min_singular_value(HOME) > 0.15
    T_world_tcp = solver.tcp_pose(HOME)
    np.testing.assert_allclose(T_world_tcp[:3, 2], (0, 0, -1), atol=2e-3)


def test_home_leaves_the_cameras_view_free(full_cell):
    """Every vertex of every robot geom is outside of the pyramid from the camera to the image's edge on the floor."""
    model, data = full_cell
    config = CellConfig()
    mujoco.mj_resetData(model, data)
    data.qpos[:6] = HOME
    mujoco.mj_kinematics(model, data)
    camera, camera_z = config.camera, config.bin.wall + config.camera.distance
    slopes = np.array([camera.height, camera.width]) / 2 / camera.focal_px  # the image's long side lies along world y
    robot = model.body_rootid[model.geom_bodyid] == model.body_rootid[model.body("forearm_link").id]
    for geom in np.flatnonzero(robot & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)):
        first, count = model.mesh_vertadr[model.geom_dataid[geom]], model.mesh_vertnum[model.geom_dataid[geom]]
        vertices = model.mesh_vert[first : first + count] @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        below = camera_z - vertices[:, 2]
        beside = np.abs(vertices[:, :2] - config.bin.position) - slopes * below[:, None]
        assert np.all((beside.max(axis=1) > 0.03) | (below < 0))


def test_bad_targets_and_seeds_are_refused(solver):
    broken = ABOVE_BIN.copy()
    broken[0, 3] = np.nan
    with pytest.raises(ValueError, match="T_world_tcp must be finite"):
        solver.solve(broken, HOME)
    with pytest.raises(ValueError, match="T_world_tcp must hold a rotation"):
        solver.solve(np.diag([1.0, 1.0, -1.0, 1.0]), HOME)
    with pytest.raises(ValueError, match=r"T_world_tcp must be \(4, 4\)"):
        solver.solve(np.eye(3), HOME)
    with pytest.raises(ValueError, match=r"seeds must be \(N, 6\)"):
        solver.solve(ABOVE_BIN, HOME[:5])
    with pytest.raises(ValueError, match="q_start must be finite"):
        solver.line(np.full(6, np.inf), ABOVE_BIN)
    with pytest.raises(ValueError, match="seeds must be finite and hold at least one"):
        solver.solve(ABOVE_BIN, np.zeros((0, 6)))


@pytest.mark.parametrize("field", ["position_tolerance", "max_iterations", "max_step", "max_jump", "line_spacing"])
def test_settings_refuse_nonsense(field):
    with pytest.raises(ValueError, match=f"{field} must be positive, got 0"):
        IkSettings(**{field: 0})


def test_settings_refuse_negative_restarts():
    with pytest.raises(ValueError, match="restarts must be at least 0, got -1"):
        IkSettings(restarts=-1)
