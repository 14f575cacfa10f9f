"""The physics: what a setting does to it, how the arm and the jaw follow, sleep, and MuJoCo itself as the oracle."""

from collections.abc import Callable
from dataclasses import fields, replace

import mujoco
import numpy as np
import pytest
from small_cell import centred, grip, small_simulation, wait

from binpick_env.config import CONTROL_PERIOD, BinConfig, CellConfig, ContactConfig, RobotConfig, TrayConfig
from binpick_env.robot import ARM_JOINTS, FINGER_PADS, HOME, TCP_SITE
from binpick_env.simulation import Push, Simulation
from perception.geometry import Floats, make_transform, matrix_from_quat, random_rotation


@pytest.fixture(scope="module")
def shared() -> Simulation:
    return small_simulation()


@pytest.fixture
def simulation(shared: Simulation) -> Simulation:
    shared.reset()
    return shared


# --- settings arrive


def test_the_contact_options_of_the_gripper_arrive() -> None:
    option = small_simulation().model.opt
    assert option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert option.impratio == 10.0
    assert option.noslip_iterations == 5
    assert option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert option.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP
    assert option.sleep_tolerance == 0.01
    assert option.timestep == 0.002


@pytest.mark.parametrize("name", [name for side in FINGER_PADS for name in side])
def test_the_pads_resist_twisting(shared: Simulation, name: str) -> None:
    pad = shared.model.geom(name)
    assert pad.condim == 6
    np.testing.assert_allclose(pad.friction, (0.7 if name.endswith("1") else 0.6, 0.005, 0.0005))


def probe(simulation: Simulation, start: tuple[float, float, float], direction: tuple[float, float, float]) -> float:
    """Return the distance from a world point to the first fixed geom along a direction [m]."""
    hit = np.zeros(1, np.int32)
    return float(mujoco.mj_ray(simulation.model, simulation.data, start, direction, None, 1, -1, hit))


def across(simulation: Simulation, position: tuple[float, float]) -> tuple[float, float]:
    """Return the inner size of the box at a position along the world's x and y, 3 cm above the table."""
    start = (*position, 0.03)
    x, y = (
        probe(simulation, start, direction) + probe(simulation, start, opposite)
        for direction, opposite in (((1, 0, 0), (-1, 0, 0)), ((0, 1, 0), (0, -1, 0)))
    )
    return x, y


def floor_and_rim(simulation: Simulation, position: tuple[float, float], beside: float) -> tuple[float, ...]:
    """Return the heights of a box's floor and of its wall, ``beside`` its middle along the world's x [m]."""
    top = 0.16  # above every wall, below the resting fingers
    return tuple(top - probe(simulation, (position[0] + x, position[1], top), (0, 0, -1)) for x in (0.0, beside))


def contact_of(name: str) -> Callable[[Simulation], object]:
    """Return how to read a contact property, which must be the same on every part, the bin and the tray."""

    def read(simulation: Simulation) -> tuple[float, ...]:
        model = simulation.model
        boxes = [model.geom(g).id for g in range(model.ngeom) if model.geom(g).name.startswith(("bin/", "tray/"))]
        pieces = [g for g in range(model.ngeom) if "/piece_" in model.geom(g).name]
        assert len(boxes) == 10
        assert len(pieces) == len(simulation.part.pieces) * simulation.capacity
        values = np.atleast_2d(getattr(model, name).T).T[[*boxes, *pieces]]
        assert (values == values[0]).all()
        return tuple(values[0].tolist())

    return read


def speed_of_a_joint(simulation: Simulation) -> float:
    simulation.step(HOME + 1.0, 0.0)
    return float((simulation.target - HOME)[0] / CONTROL_PERIOD)


def time_of_the_jaw(simulation: Simulation) -> float:
    simulation.step(HOME, 1.0)
    return CONTROL_PERIOD / simulation.gripper_target


def length_of_ten_steps(simulation: Simulation) -> tuple[float, int]:
    wait(simulation, 10 * CONTROL_PERIOD)
    return simulation.time, simulation.substeps


def bin_turn(simulation: Simulation) -> float:
    x_axis = simulation.data.body("bin").xmat.reshape(3, 3)[:, 0]
    return float(np.arctan2(x_axis[1], x_axis[0]))


HERE = (0.45, 0.1)
SETTINGS = {
    "bin.inner_size": (BinConfig(inner_size=(0.3, 0.2, 0.1)), lambda s: across(s, (0.5, 0.0)), (0.2, 0.3)),
    "bin.inner_size, height": (
        BinConfig(inner_size=(0.3, 0.2, 0.1)),
        lambda s: floor_and_rim(s, (0.5, 0), 0.11),
        (0.02, 0.12),
    ),
    "bin.wall": (BinConfig(wall=0.025), lambda s: floor_and_rim(s, (0.5, 0), 0.154), (0.025, 0.145)),
    "bin.position": (BinConfig(position=HERE), lambda s: (*across(s, HERE), *s.data.body("bin").xpos[:2]), None),
    "bin.yaw": (BinConfig(yaw=0.5), bin_turn, 0.5),
    "tray.inner_size": (TrayConfig(inner_size=(0.2, 0.15, 0.05)), lambda s: across(s, (0.42, -0.42)), (0.2, 0.15)),
    "tray.wall": (TrayConfig(wall=0.02), lambda s: floor_and_rim(s, (0.42, -0.42), 0.13), (0.02, 0.08)),
    "tray.position": (TrayConfig(position=(0.3, 0.4)), lambda s: across(s, (0.3, 0.4)), (0.24, 0.24)),
    "robot.pedestal_height": (RobotConfig(pedestal_height=0.3), lambda s: s.data.body("base").xpos[2], 0.3),
    "robot.max_velocity": (RobotConfig(max_velocity=1.5), speed_of_a_joint, 1.5),
    "robot.gripper_time": (RobotConfig(gripper_time=1.0), time_of_the_jaw, 1.0),
    "contact.condim": (ContactConfig(condim=4), contact_of("geom_condim"), (4,)),
    "contact.friction": (ContactConfig(friction=(0.3, 0.01, 0.001)), contact_of("geom_friction"), (0.3, 0.01, 0.001)),
    "contact.solref": (ContactConfig(solref=(0.02, 0.9)), contact_of("geom_solref"), (0.02, 0.9)),
    "contact.solimp": (
        ContactConfig(solimp=(0.8, 0.9, 0.002, 0.4, 1.5)),
        contact_of("geom_solimp"),
        (0.8, 0.9, 0.002, 0.4, 1.5),
    ),
    "contact.joint_damping": (
        ContactConfig(joint_damping=3e-4),
        lambda s: s.model.dof_damping[s.model.joint("part_2").dofadr[0] :],
        (3e-4,) * 6,
    ),
    "contact.sleep_tolerance": (ContactConfig(sleep_tolerance=0.002), lambda s: s.model.opt.sleep_tolerance, 0.002),
    "timestep": (0.004, length_of_ten_steps, (0.4, 10)),
}
SETTINGS["bin.position"] = (*SETTINGS["bin.position"][:2], (0.26, 0.36, *HERE))
# The first is the planner's, see tests/test_policies/test_motion.py; the camera's are in test_env.py.
ELSEWHERE = {"robot.max_acceleration", "camera"}


@pytest.mark.parametrize("name", SETTINGS)
def test_a_setting_arrives(shared: Simulation, name: str) -> None:
    value, observe, expected = SETTINGS[name]
    shared.reset()
    assert observe(shared) != pytest.approx(expected, abs=1e-6)
    config = replace(CellConfig(), **{name.split(".")[0]: value})
    assert observe(small_simulation(config=config)) == pytest.approx(expected, abs=1e-6)


def test_every_setting_is_looked_at() -> None:
    names = set()
    for field in fields(CellConfig):
        value = getattr(CellConfig(), field.name)
        inner = field.name not in ("camera", "timestep")
        names |= {f"{field.name}.{f.name}" for f in fields(value)} if inner else {field.name}
    assert names == {name.split(",")[0] for name in SETTINGS} | ELSEWHERE


# --- the arm follows


def smooth_move(simulation: Simulation, axis: int, turn: float, seconds: float) -> tuple[Floats, Floats]:
    """Move one joint along a quintic; return how far joints are off the planned path (N, 6), and targets (N, 6)."""
    start = simulation.target.copy()
    reference = [start]
    off, targets = [], []
    for s in np.arange(1, round(seconds / CONTROL_PERIOD) + 1) * CONTROL_PERIOD / seconds:
        goal = start.copy()
        goal[axis] += turn * (10 * s**3 - 15 * s**4 + 6 * s**5)
        simulation.step(goal, 0.0)
        reference.append(goal)
        # The spline through the targets is half a period late; that is the plan, not the servo.
        off.append(simulation.joint_positions - (reference[-1] + reference[-2]) / 2)
        targets.append(simulation.target)
    return np.array(off), np.array(targets)


@pytest.mark.parametrize("axis", range(6))
def test_a_smooth_move_is_followed(simulation: Simulation, axis: int) -> None:
    """The servos alone lag by 0.2 s, which was up to 300 mrad here, and ended 10 to 20 mrad off."""
    off, targets = smooth_move(simulation, axis, turn=-1.0, seconds=1.0)
    assert np.abs(off).max() < 0.005
    assert targets[-1, axis] == pytest.approx(HOME[axis] - 1.0)
    simulation.step(simulation.target, 0.0)
    assert np.abs(simulation.joint_positions - simulation.target).max() < 0.002
    wait(simulation, 0.4, simulation.target)
    assert np.abs(simulation.joint_positions - simulation.target).max() < 5e-4
    assert np.abs(simulation.joint_velocities).max() < 1e-3


def test_an_arm_at_home_stays_there(simulation: Simulation) -> None:
    wait(simulation, 2.0)
    np.testing.assert_allclose(simulation.joint_positions, HOME, atol=1e-4)


def test_targets_are_held_to_the_arms_velocity(simulation: Simulation) -> None:
    limit = simulation.config.robot.max_velocity
    rng = np.random.default_rng(0)
    targets = [simulation.target]
    for _ in range(60):
        simulation.step(HOME + rng.choice([-1.0, 1.0], 6) * rng.uniform(0.0, 0.6, 6), 0.0)
        targets.append(simulation.target)
    speeds = np.abs(np.diff(targets, axis=0)) / CONTROL_PERIOD
    assert speeds.max() == pytest.approx(limit)


def test_a_far_target_is_reached_at_full_speed_and_not_overshot(simulation: Simulation) -> None:
    goal = HOME + np.array([-1.5, 0, 0, 0, 0, 0])
    periods = int(np.ceil(1.5 / simulation.config.robot.max_velocity / CONTROL_PERIOD))
    for _ in range(periods - 1):
        simulation.step(goal, 0.0)
        assert abs(simulation.joint_velocities[0]) < 1.1 * simulation.config.robot.max_velocity
    assert simulation.target[0] > goal[0]
    simulation.step(goal, 0.0)
    np.testing.assert_allclose(simulation.target, goal)
    lowest = goal[0]
    for _ in range(25):
        simulation.step(goal, 0.0)
        lowest = min(lowest, simulation.joint_positions[0])
    assert goal[0] - lowest < 0.1  # a stop from 180 deg/s within one period is beyond any drive
    assert simulation.joint_positions[0] == pytest.approx(goal[0], abs=1e-3)


# --- the jaw follows


def test_the_jaw_keeps_to_its_speed(simulation: Simulation) -> None:
    stroke = CONTROL_PERIOD / simulation.config.robot.gripper_time
    assert simulation.gripper_position == pytest.approx(0.0, abs=1e-3)
    for command in (1.0, 0.0):
        positions, targets = [simulation.gripper_position], []
        for _ in range(30):
            simulation.step(HOME, command)
            positions.append(simulation.gripper_position)
            targets.append(simulation.gripper_target)
        assert np.abs(np.diff(targets)).max() == pytest.approx(stroke)
        assert 0.9 * stroke < np.abs(np.diff(positions)).max() < 1.15 * stroke
        assert simulation.gripper_position == pytest.approx(command, abs=0.03)


def test_a_jaw_command_beyond_its_range_is_held_to_it(simulation: Simulation) -> None:
    wait(simulation, 1.2, gripper=7.0)
    assert simulation.gripper_target == 1.0
    wait(simulation, 1.2, gripper=-7.0)
    assert simulation.gripper_target == 0.0


def test_a_squeezing_jaw_opens_at_once(simulation: Simulation) -> None:
    """Its target had run ahead to 1 while a part held it at 0.67: opening began a third of the stroke later."""
    grip(simulation, 0)
    before = simulation.gripper_position
    assert simulation.gripper_target == 1.0
    assert before < 0.75
    simulation.step(HOME, 0.0)
    assert simulation.gripper_target < before
    simulation.step(HOME, 0.0)
    assert simulation.gripper_position < before - 0.02


def test_a_gripped_part_does_not_creep(simulation: Simulation) -> None:
    grip(simulation, 0)
    T_tcp_part = np.linalg.inv(simulation.T_world_tcp) @ simulation.part_poses()[0]
    wait(simulation, 5.0, gripper=1.0)
    crept = np.linalg.inv(simulation.T_world_tcp) @ simulation.part_poses()[0] - T_tcp_part
    assert simulation.gripped() == {0}
    assert simulation.model.opt.noslip_iterations == 5
    assert np.linalg.norm(crept[:3, 3]) < 5e-4
    assert np.abs(crept[:3, :3]).max() < 0.01


# --- contacts


def test_nothing_is_touched_at_home(simulation: Simulation) -> None:
    wait(simulation, 0.2)
    assert simulation.robot_push() == Push(force=0.0, with_cell=False, parts=frozenset())
    assert not simulation.touched_by_gripper().any()
    assert simulation.gripped() == frozenset()


def test_a_squeezed_part_is_named_by_all_three(simulation: Simulation) -> None:
    grip(simulation, 1)
    assert simulation.gripped() == {1}
    np.testing.assert_array_equal(simulation.touched_by_gripper(), [False, True, False])
    push = simulation.robot_push()
    assert push.parts == {1}
    assert not push.with_cell
    assert push.force > 5.0


def test_a_part_that_falls_on_the_arm_is_touched_but_not_gripped(simulation: Simulation) -> None:
    x, y, z = simulation.data.body("forearm_link").xpos
    simulation.place(0, centred(simulation, (x, y, z + 0.15)))
    for _ in range(25):
        simulation.step(HOME, 0.0)
        if simulation.touched_by_gripper()[0]:
            break
    assert simulation.touched_by_gripper()[0]
    assert simulation.gripped() == frozenset()


def test_leaning_on_the_table_is_felt(simulation: Simulation) -> None:
    down = HOME + np.array([0, 0.9, 0, 0, 0, 0])
    wait(simulation, 1.0, down, gripper=1.0)
    push = simulation.robot_push()
    assert push.with_cell
    assert push.parts == frozenset()
    assert push.force > 50.0


def test_contact_forces_balance_a_parts_weight(simulation: Simulation) -> None:
    grip(simulation, 0)
    wait(simulation, 1.0, gripper=1.0)
    total = np.zeros(3)
    wrench = np.zeros(6)
    for c in range(simulation.data.ncon):
        contact = simulation.data.contact[c]
        mujoco.mj_contactForce(simulation.model, simulation.data, c, wrench)
        sign = 1.0 if simulation.part_of_geom[contact.geom[1]] == 0 else -1.0
        if 0 in simulation.part_of_geom[contact.geom]:
            total += sign * (contact.frame.reshape(3, 3).T @ wrench[:3])
    np.testing.assert_allclose(total, (0, 0, 9.81 * simulation.part.mass), atol=0.02)


# --- sleep


@pytest.fixture
def sleeping(simulation: Simulation) -> Simulation:
    """Three tees lie asleep in the bin, two of them touching."""
    for i, (x, y) in enumerate([(0.5, 0.0), (0.5, 0.037), (0.45, -0.1)]):
        simulation.place(i, centred(simulation, (x, y, 0.07)))
    wait(simulation, 2.0)
    assert simulation.asleep().all()
    return simulation


def test_a_sleeping_part_does_not_move_at_all(sleeping: Simulation) -> None:
    before = sleeping.part_poses()
    wait(sleeping, 1.0)
    np.testing.assert_array_equal(sleeping.part_poses(), before)
    np.testing.assert_array_equal(sleeping.part_speeds(), 0.0)


def test_a_sleeping_part_wakes_when_another_falls_on_it(sleeping: Simulation) -> None:
    x, y, z = sleeping.part_centres()[0]
    sleeping.place(2, centred(sleeping, (x, y, z + 0.12)))
    awake = np.zeros(3, dtype=bool)
    for _ in range(10):
        sleeping.step(HOME, 0.0)
        awake |= ~sleeping.asleep()
    assert awake[0]
    assert awake[2]


def test_a_sleeping_part_wakes_when_the_arm_touches_it(simulation: Simulation) -> None:
    simulation.place(0, centred(simulation, (0.42, -0.42, 0.05)))  # in the tray, under the tcp
    wait(simulation, 2.0)
    assert simulation.asleep()[0]
    before = simulation.part_centres()[0]
    wait(simulation, 1.0, HOME + np.array([0, 0.7, 0, 0, 0, 0]), gripper=1.0)
    assert not simulation.asleep()[0] or np.linalg.norm(simulation.part_centres()[0] - before) > 0.002
    assert np.linalg.norm(simulation.part_centres()[0] - before) > 1e-4


def test_a_part_whose_support_is_taken_away_falls(simulation: Simulation) -> None:
    simulation.place(0, centred(simulation, (0.5, 0.0, 0.05)))
    wait(simulation, 1.0)
    x, y, z = simulation.part_centres()[0]
    simulation.place(1, centred(simulation, (x, y, z + 0.06)))
    wait(simulation, 2.0)
    assert simulation.asleep()[:2].all()
    high = simulation.part_centres()[1, 2]
    simulation.park(0)
    wait(simulation, 1.0)
    assert simulation.part_centres()[1, 2] < high - 0.005


# --- parts


def test_parked_parts_hang_where_they_are(simulation: Simulation) -> None:
    before = simulation.part_poses()
    wait(simulation, 1.0)
    np.testing.assert_array_equal(simulation.part_poses(), before)
    assert simulation.asleep().all()
    assert not simulation.in_play.any()
    assert before[:, 2, 3].max() < -3.0


def test_a_placed_part_falls_freely(simulation: Simulation) -> None:
    pose = centred(simulation, (0.5, 0.0, 0.8), angle=0.4)
    simulation.place(1, pose)
    np.testing.assert_allclose(simulation.part_poses()[1], pose, atol=1e-12)
    np.testing.assert_array_equal(simulation.in_play, [False, True, False])
    wait(simulation, 0.2)
    fallen = 0.8 - simulation.part_centres()[1, 2]
    assert fallen == pytest.approx(0.5 * 9.81 * 0.2**2, rel=0.02)
    assert simulation.part_speeds()[1] == pytest.approx(9.81 * 0.2, rel=0.02)


def test_a_part_is_parked_and_placed_again(simulation: Simulation) -> None:
    simulation.place(0, centred(simulation, (0.5, 0.0, 0.8)))
    wait(simulation, 0.2)
    simulation.park(0)
    assert not simulation.in_play[0]
    assert simulation.part_speeds()[0] == 0.0
    wait(simulation, 1.0)
    assert simulation.part_centres()[0, 2] < -3.9
    assert simulation.asleep()[0]
    simulation.place(0, centred(simulation, (0.5, 0.0, 0.8)))
    wait(simulation, 0.2)
    assert simulation.part_speeds()[0] > 1.0


def test_a_rims_speed_counts(simulation: Simulation) -> None:
    simulation.place(0, centred(simulation, (0.5, 0.0, 0.8)))
    simulation.data.qvel[simulation.model.joint("part_0").dofadr[0] + 5] = 10.0
    assert simulation.part_speeds()[0] == pytest.approx(10.0 * simulation.part.model.d_max / 2)


def test_reset_forgets_everything(simulation: Simulation) -> None:
    grip(simulation, 0)
    wait(simulation, 0.5, HOME + 0.3, 1.0)
    simulation.reset()
    assert simulation.time == 0.0
    np.testing.assert_array_equal(simulation.joint_positions, HOME)
    np.testing.assert_array_equal(simulation.target, HOME)
    assert (simulation.gripper_target, simulation.gripper_position) == (0.0, 0.0)
    assert not simulation.in_play.any()
    first = [simulation.joint_positions for _ in range(5) if simulation.step(HOME - 0.2, 0.5) is None]
    fresh = small_simulation()
    again = [fresh.joint_positions for _ in range(5) if fresh.step(HOME - 0.2, 0.5) is None]
    np.testing.assert_array_equal(first, again)


# --- MuJoCo as the oracle


def test_poses_are_mujocos(simulation: Simulation) -> None:
    rng = np.random.default_rng(1)
    for i in range(3):
        simulation.place(i, make_transform(random_rotation(rng), (0.5, 0.15 * i - 0.15, 0.4)))
    simulation.step(HOME - 0.1, 0.6)
    mujoco.mj_forward(simulation.model, simulation.data)
    for i, pose in enumerate(simulation.part_poses()):
        body = simulation.data.body(f"part_{i}")
        np.testing.assert_allclose(pose[:3, 3], body.xpos, atol=1e-12)
        np.testing.assert_allclose(pose[:3, :3], matrix_from_quat(body.xquat), atol=1e-12)
        np.testing.assert_allclose(simulation.part_centres()[i], body.xipos, atol=1e-12)
    site = simulation.data.site(TCP_SITE)
    np.testing.assert_array_equal(simulation.T_world_tcp[:3, :3], site.xmat.reshape(3, 3))
    np.testing.assert_array_equal(simulation.T_world_tcp[:3, 3], site.xpos)
    for k, name in enumerate(ARM_JOINTS):
        assert simulation.joint_positions[k] == simulation.data.joint(name).qpos[0]
        assert simulation.joint_velocities[k] == simulation.data.joint(name).qvel[0]


def test_speeds_are_mujocos(simulation: Simulation) -> None:
    simulation.place(0, make_transform(random_rotation(np.random.default_rng(2)), (0.5, 0.0, 0.6)))
    simulation.data.qvel[simulation.model.joint("part_0").dofadr[0] + np.arange(3, 6)] = (3.0, -2.0, 1.0)
    wait(simulation, 0.1)
    mujoco.mj_forward(simulation.model, simulation.data)
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(
        simulation.model, simulation.data, mujoco.mjtObj.mjOBJ_XBODY, simulation.model.body("part_0").id, velocity, 0
    )
    assert simulation.part_speeds()[0] == pytest.approx(
        max(np.linalg.norm(velocity[3:]), np.linalg.norm(velocity[:3]) * simulation.part.model.d_max / 2)
    )


# --- faults


def test_a_crammed_heap_has_room_for_its_constraints() -> None:
    """MuJoCo's own 18 MB ended in a FatalError, or in contacts left out with no more than a line in a log file."""
    simulation = small_simulation(7)
    rng = np.random.default_rng(0)
    for i in range(7):
        simulation.place(i, make_transform(random_rotation(rng), (0.47 + 0.02 * (i % 4), 0.02 * (i // 4), 0.08)))
    mujoco.mj_step(simulation.model, simulation.data)
    assert simulation.data.maxuse_arena > 20e6
    assert sum(warning.number for warning in simulation.data.warning) == 0


@pytest.mark.parametrize("where", ["qpos", "qvel", "xfrc_applied"])
def test_a_diverged_state_is_an_error(simulation: Simulation, where: str) -> None:
    """MuJoCo used to put the state back to its own start, silently."""
    getattr(simulation.data, where)[-1] = np.nan
    with pytest.raises(FloatingPointError, match=r"the physics diverged at t = 0\.\d{3} s \(NaN in the state\)"):
        wait(simulation, 0.2)
    simulation.reset()
    wait(simulation, 0.2)
    assert np.isfinite(simulation.data.qpos).all()
