"""How the arm and the jaw follow their targets."""

import numpy as np
import pytest

from binpick_env.cell.robot import HOME
from binpick_env.cell.simulation import Simulation
from binpick_env.config import CONTROL_PERIOD
from perception.geometry import Floats
from tests.binpick_env.small_cell import grip, wait

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
