"""Where the arm presses too hard it stops, and obeys again what leads away."""

import mujoco
import numpy as np
import pytest

from binpick_env.cell.protective_stop import HOLD
from binpick_env.cell.robot import HOME
from binpick_env.cell.simulation import Simulation
from binpick_env.config import CONTROL_PERIOD, CellConfig, RobotConfig
from perception.geometry import Floats
from tests.binpick_env.small_cell import grip, small_simulation, wait

DOWN = HOME + np.array([0.0, 0.8, 0.0, 0.0, 0.0, 0.0])  # the tool would be 0.1 m under the tray
LIMIT = 150.0  # [N]


def force_of_contacts(simulation: Simulation) -> Floats:
    """Return the (3,) force of all contacts on the robot [N] in the world."""
    force, wrench = np.zeros(3), np.zeros(6)
    for c, ends in enumerate(simulation.robot_ends()):
        if ends[0] != ends[1]:
            mujoco.mj_contactForce(simulation.model, simulation.data, c, wrench)
            on_second = simulation.data.contact.frame[c].reshape(3, 3).T @ wrench[:3]
            force += on_second if ends[1] else -on_second
    return force


def press(simulation: Simulation, steps: int = 25) -> Floats:
    """Drive the tool onto the tray; return the (steps,) forces on it at the steps' ends [N]."""
    forces = []
    for _ in range(steps):
        simulation.step(DOWN, 1.0)
        forces.append(np.linalg.norm(force_of_contacts(simulation)))
    return np.array(forces)


@pytest.fixture(scope="module")
def unlimited() -> Simulation:
    return small_simulation(config=CellConfig(robot=RobotConfig(protective_stop=None)))


def test_an_arm_that_presses_too_hard_stops_and_stays(simulation: Simulation, unlimited: Simulation) -> None:
    unlimited.reset()
    assert press(unlimited)[8:].min() > LIMIT
    assert not unlimited.stopped
    forces = press(simulation)
    assert simulation.stopped
    assert forces[8:].max() < LIMIT
    before = simulation.joint_positions
    press(simulation, 10)
    assert simulation.stopped
    np.testing.assert_allclose(simulation.joint_positions, before, atol=0.005)


def test_a_stopped_arm_obeys_a_command_that_leads_away_and_no_other(simulation: Simulation) -> None:
    press(simulation, 8)
    at = simulation.target.copy()
    sideways_and_down = at + np.array([0.3, 0.05, 0.0, 0.0, 0.0, 0.0])
    simulation.step(sideways_and_down, 1.0)
    assert simulation.stopped
    np.testing.assert_array_equal(simulation.target, at)
    for rounded in (at, at.astype(np.float32), np.nextafter(at.astype(np.float32), np.float32(9))):
        simulation.step(rounded.astype(np.float64), 1.0)  # to stay where it is leads nowhere
        assert simulation.stopped
    wait(simulation, 0.4, HOME)
    assert not simulation.stopped
    np.testing.assert_allclose(simulation.joint_positions, HOME, atol=0.005)


def test_a_stop_that_is_pressed_on_ends_after_a_second_for_another_try(simulation: Simulation) -> None:
    targets: list[Floats] = []
    while len(targets) < 60:
        simulation.step(DOWN, 1.0)
        targets.append(simulation.target.copy())
    moved = np.flatnonzero(np.abs(np.diff(targets, axis=0)).max(axis=1) > 0)
    waits = np.diff(moved)
    assert waits.max() >= round(HOLD / CONTROL_PERIOD)  # without a motion before it tries again
    assert moved[-1] > 30
    assert simulation.stopped


def test_a_stop_in_which_the_arm_still_presses_lasts_no_longer() -> None:
    simulation = small_simulation(config=CellConfig(robot=RobotConfig(protective_stop=30.0)))
    while not simulation.stopped:
        simulation.step(DOWN, 1.0)
    stopped = []
    while simulation.stopped and len(stopped) < 60:
        simulation.step(simulation.target, 1.0)
        stopped.append(simulation.stopped)
    assert len(stopped) <= round(HOLD / CONTROL_PERIOD) + 1


def test_the_force_is_that_of_the_contacts_on_the_tool(unlimited: Simulation) -> None:
    unlimited.reset()
    press(unlimited)
    force = force_of_contacts(unlimited)
    assert np.linalg.norm(force) > 100
    np.testing.assert_allclose(unlimited._stop._force(), force, atol=0.05 * float(np.linalg.norm(force)))


def test_a_grip_is_no_force_on_the_tool(simulation: Simulation) -> None:
    grip(simulation, 1)
    assert simulation.robot_contact().force > 5.0
    assert np.linalg.norm(simulation._stop._force()) < 1.0


def test_the_limit_is_the_configs() -> None:
    gentle = small_simulation(config=CellConfig(robot=RobotConfig(protective_stop=40.0)))
    assert press(gentle)[8:].max() < 50.0  # it rests on the tray with what it stopped at
    assert gentle.stopped


def test_a_snapshot_knows_that_the_arm_is_stopped(simulation: Simulation) -> None:
    press(simulation)
    snapshot, after = simulation.snapshot(), []
    for _ in range(2):
        simulation.restore(snapshot)
        assert simulation.stopped
        press(simulation, 3)
        after.append(simulation.data.qpos.copy())
        wait(simulation, 0.2, HOME)
        assert not simulation.stopped
    np.testing.assert_array_equal(*after)


def test_a_reset_and_an_arm_that_is_put_elsewhere_end_the_stop(simulation: Simulation) -> None:
    press(simulation)
    simulation.put_arm(HOME, HOME)
    assert not simulation.stopped
    press(simulation)
    assert simulation.stopped
    simulation.reset()
    assert not simulation.stopped
