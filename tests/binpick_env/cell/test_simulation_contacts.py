"""What touches what in the physics, and what sleeps and wakes by it."""

import mujoco
import numpy as np
import pytest

from binpick_env.cell.robot import HOME
from binpick_env.cell.simulation import RobotContact, Simulation
from perception.geometry import make_transform, random_rotation
from tests.binpick_env.small_cell import centred, grip, small_simulation, wait

# --- contacts


def test_nothing_is_touched_at_home(simulation: Simulation) -> None:
    wait(simulation, 0.2)
    assert simulation.robot_contact() == RobotContact(force=0.0, with_cell=False, parts=frozenset())
    assert not simulation.touched_by_robot().any()
    assert simulation.gripped() == frozenset()


def test_a_squeezed_part_is_named_by_all_three(simulation: Simulation) -> None:
    grip(simulation, 1)
    assert simulation.gripped() == {1}
    np.testing.assert_array_equal(simulation.touched_by_robot(), [False, True, False])
    push = simulation.robot_contact()
    assert push.parts == {1}
    assert not push.with_cell
    assert push.force > 5.0


def test_a_part_that_falls_on_the_arm_is_touched_but_not_gripped(simulation: Simulation) -> None:
    x, y, z = simulation.data.body("forearm_link").xpos
    simulation.place(0, centred(simulation, (x, y, z + 0.15)))
    for _ in range(25):
        simulation.step(HOME, 0.0)
        if simulation.touched_by_robot()[0]:
            break
    assert simulation.touched_by_robot()[0]
    assert simulation.gripped() == frozenset()


def test_leaning_on_the_table_is_felt(simulation: Simulation) -> None:
    for lean in [*np.arange(0.0, 0.45, 0.03), *np.arange(0.45, 0.6, 0.002)]:  # a harder hit ends in a protective stop
        simulation.step(HOME + np.array([0, lean, 0, 0, 0, 0]), 1.0)
        if simulation.robot_contact().force > 60.0:
            break
    push = simulation.robot_contact()
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


def test_a_crammed_heap_has_room_for_its_constraints() -> None:
    """MuJoCo's own 18 MB ended in a FatalError, or in contacts left out with no more than a line in a log file."""
    simulation = small_simulation(7)
    rng = np.random.default_rng(0)
    for i in range(7):
        simulation.place(i, make_transform(random_rotation(rng), (0.47 + 0.02 * (i % 4), 0.02 * (i // 4), 0.08)))
    mujoco.mj_step(simulation.model, simulation.data)
    assert simulation.data.maxuse_arena > 20e6
    assert sum(warning.number for warning in simulation.data.warning) == 0


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


def test_what_the_opening_jaw_leaves_falls(simulation: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    weightless = np.ones_like(simulation.model.body_gravcomp)
    simulation.place(0, centred(simulation, (0.5, 0.0, 0.4)))
    weight = simulation.model.body_gravcomp.copy()
    simulation.model.body_gravcomp[:] = weightless
    wait(simulation, 0.4, gripper=1.0)
    simulation.model.body_gravcomp[:] = weight
    # It sleeps in mid-air, as what hung still in the jaw may do in the very step in which the pads leave it.
    monkeypatch.setattr(Simulation, "touched_by_robot", lambda _: np.array([True, False, False]))
    wait(simulation, 0.4, gripper=1.0)
    assert simulation.asleep()[0]
    assert simulation.part_centres()[0, 2] > 0.39
    simulation.step(HOME, 0.0)
    wait(simulation, 0.4, gripper=1.0)
    assert simulation.part_centres()[0, 2] < 0.1
