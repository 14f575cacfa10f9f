"""Deliveries are judged by where parts physically come to rest, and when they were let go."""

from collections.abc import Callable

import numpy as np
import pytest

from binpick_env.cell.delivery import LOST_AFTER, REST_TIME, Delivery, DeliveryEvent, DeliveryJudge
from binpick_env.cell.robot import HOME
from binpick_env.cell.simulation import Simulation
from binpick_env.config import CONTROL_PERIOD, CellConfig, RobotConfig, TrayConfig
from tests.binpick_env.small_cell import above_tray, centred, grip, small_simulation

Watch = Callable[..., list[DeliveryEvent]]
TABLE = (0.8, 0.4, 0.08)  # above the table, away from bin and tray


@pytest.fixture(scope="module")
def shared() -> Simulation:
    return small_simulation(5)


@pytest.fixture
def simulation(shared: Simulation) -> Simulation:
    shared.reset()
    return shared


@pytest.fixture
def judge(simulation: Simulation) -> DeliveryJudge:
    return DeliveryJudge(simulation, CONTROL_PERIOD)


def watch(judge: DeliveryJudge, simulation: Simulation, seconds: float, gripper: float = 0.0) -> list[DeliveryEvent]:
    """Let time pass with the arm at home and one command to the jaw."""
    events = []
    for _ in range(round(seconds / CONTROL_PERIOD)):
        simulation.step(HOME, gripper)
        events += judge.update(gripper)
    return events


def kinds(events: list[DeliveryEvent]) -> dict[int, Delivery]:
    assert len({event.part for event in events}) == len(events), "a part was judged twice"
    return {event.part: event.kind for event in events}


# --- in the tray


def test_a_part_let_go_over_the_tray_is_delivered_once(simulation: Simulation, judge: DeliveryJudge) -> None:
    simulation.place(2, above_tray(simulation))
    (event,) = watch(judge, simulation, 3.0)
    assert (event.part, event.kind) == (2, Delivery.DELIVERED)
    assert REST_TIME < event.time < 1.5
    assert not simulation.in_play.any()
    assert simulation.part_centres()[2, 2] < -3.0
    assert not judge.inside_tray().any()


def test_a_part_is_not_judged_before_it_rests(simulation: Simulation, judge: DeliveryJudge) -> None:
    simulation.place(0, above_tray(simulation, z=0.05))
    entered = 0.0
    while simulation.in_play[0]:
        simulation.step(HOME, 0.0)
        speed = simulation.part_speeds()[0]
        events = judge.update(0.0)
        if speed > 0.02:
            entered = simulation.time
            assert events == []
    assert simulation.time - entered == pytest.approx(REST_TIME, abs=CONTROL_PERIOD)


@pytest.mark.parametrize("count", [2, 5])
def test_parts_that_come_together_are_no_delivery(simulation: Simulation, judge: DeliveryJudge, count: int) -> None:
    for i in range(count):
        simulation.place(i, above_tray(simulation, 0.07 * (i % 3) - 0.07, 0.08 * (i // 3) - 0.04, 0.04))
    assert kinds(watch(judge, simulation, 4.0)) == dict.fromkeys(range(count), Delivery.DOUBLE)
    assert not simulation.in_play.any()


def test_a_part_on_top_of_another_is_no_delivery(simulation: Simulation, judge: DeliveryJudge) -> None:
    """The upper one's centre rests above the rim: the lower one used to be judged alone, and delivered."""
    simulation.place(0, above_tray(simulation, z=0.03))
    assert watch(judge, simulation, 0.08) == []
    simulation.place(1, above_tray(simulation, z=0.08))
    assert kinds(watch(judge, simulation, 3.0)) == {0: Delivery.DOUBLE, 1: Delivery.DOUBLE}


def test_one_release_after_the_other(simulation: Simulation, judge: DeliveryJudge) -> None:
    for i in range(3):
        simulation.place(i, above_tray(simulation))
        assert kinds(watch(judge, simulation, 1.6)) == {i: Delivery.DELIVERED}
        assert watch(judge, simulation, 0.4, gripper=1.0) == []


def test_a_second_part_of_one_release_is_no_delivery(simulation: Simulation, judge: DeliveryJudge) -> None:
    simulation.place(0, above_tray(simulation))
    assert kinds(watch(judge, simulation, 1.6)) == {0: Delivery.DELIVERED}
    simulation.place(1, above_tray(simulation))  # the jaw has not closed and opened in between
    assert kinds(watch(judge, simulation, 1.6)) == {1: Delivery.DOUBLE}


def test_a_part_that_leaves_again_was_in_company(simulation: Simulation, judge: DeliveryJudge) -> None:
    for i in range(2):
        simulation.place(i, above_tray(simulation, x=0.06 * (2 * i - 1), z=0.05))
    assert watch(judge, simulation, 0.08) == []
    simulation.place(1, centred(simulation, TABLE))
    assert kinds(watch(judge, simulation, 3.0)) == {0: Delivery.DOUBLE, 1: Delivery.LEFT_BIN}


def test_a_part_that_falls_from_a_closed_jaw_was_not_released(simulation: Simulation, judge: DeliveryJudge) -> None:
    simulation.place(0, above_tray(simulation))
    assert kinds(watch(judge, simulation, 2.0, gripper=1.0)) == {0: Delivery.UNRELEASED}


def test_opening_afterwards_does_not_make_it_released(simulation: Simulation, judge: DeliveryJudge) -> None:
    simulation.place(0, above_tray(simulation, z=0.05))
    assert watch(judge, simulation, 0.12, gripper=1.0) == []
    assert kinds(watch(judge, simulation, 2.0)) == {0: Delivery.UNRELEASED}
    watch(judge, simulation, 0.2, gripper=1.0)
    simulation.place(0, above_tray(simulation))  # the same part, let go properly: the verdict is forgotten
    assert kinds(watch(judge, simulation, 2.0)) == {0: Delivery.DELIVERED}


# --- in the fingers


@pytest.fixture(scope="module")
def high_tray() -> Simulation:
    """Return a cell whose tray reaches up to the resting fingers."""
    config = CellConfig(tray=TrayConfig(wall=0.12), robot=RobotConfig(pedestal_height=0.02))
    simulation = small_simulation(2, config)
    tcp = simulation.T_world_tcp[:3, 3]
    assert 0.03 < tcp[2] - config.tray.wall < 0.06
    return simulation


def test_a_held_part_is_not_judged_and_then_delivered(high_tray: Simulation) -> None:
    high_tray.reset()
    judge = DeliveryJudge(high_tray, CONTROL_PERIOD)
    watch(judge, high_tray, 0.4, gripper=1.0)
    grip(high_tray, 0)
    assert watch(judge, high_tray, 3.0, gripper=1.0) == []
    assert high_tray.gripped() == {0}
    assert judge.inside_tray()[0]
    assert not judge.loose().any()
    assert kinds(watch(judge, high_tray, 2.0)) == {0: Delivery.DELIVERED}


def test_company_waits_for_the_part_that_is_held(high_tray: Simulation) -> None:
    high_tray.reset()
    judge = DeliveryJudge(high_tray, CONTROL_PERIOD)
    watch(judge, high_tray, 0.4, gripper=1.0)
    grip(high_tray, 0)
    high_tray.place(1, above_tray(high_tray, x=0.07, y=0.07, z=0.03))
    assert watch(judge, high_tray, 2.0, gripper=1.0) == []
    assert kinds(watch(judge, high_tray, 2.0)) == {0: Delivery.DOUBLE, 1: Delivery.UNRELEASED}


def test_a_part_carried_for_long_is_not_lost(simulation: Simulation, judge: DeliveryJudge) -> None:
    grip(simulation, 3)
    assert watch(judge, simulation, 3 * LOST_AFTER, gripper=1.0) == []
    assert simulation.gripped() == {3}
    assert not judge.loose().any()


def test_a_part_dropped_from_home_lands_and_is_delivered(simulation: Simulation, judge: DeliveryJudge) -> None:
    grip(simulation, 3)
    assert watch(judge, simulation, 0.4, gripper=1.0) == []
    assert kinds(watch(judge, simulation, 3.0)) == {3: Delivery.DELIVERED}


# --- elsewhere


def test_a_part_on_the_table_has_left_the_bin(simulation: Simulation, judge: DeliveryJudge) -> None:
    simulation.place(1, centred(simulation, TABLE))
    (event,) = watch(judge, simulation, 4.0)
    assert (event.part, event.kind) == (1, Delivery.LEFT_BIN)
    assert event.time > LOST_AFTER
    assert not simulation.in_play[1]


def test_a_part_beside_the_table_has_left_the_bin(simulation: Simulation, judge: DeliveryJudge) -> None:
    simulation.place(1, centred(simulation, (1.5, 0.0, 0.1)))
    (event,) = watch(judge, simulation, 2.0)
    assert event.kind is Delivery.LEFT_BIN
    assert event.time == pytest.approx(LOST_AFTER + np.sqrt(2 * 0.1 / 9.81), abs=2 * CONTROL_PERIOD)


def test_a_part_on_its_way_is_loose_and_not_yet_judged(simulation: Simulation, judge: DeliveryJudge) -> None:
    simulation.place(0, centred(simulation, TABLE))
    assert watch(judge, simulation, 0.4) == []
    np.testing.assert_array_equal(judge.loose(), [True, False, False, False, False])


def test_parts_in_the_bin_are_left_alone(simulation: Simulation, judge: DeliveryJudge) -> None:
    for i in range(5):
        simulation.place(i, centred(simulation, (0.5, 0.07 * i - 0.14, 0.08)))
    assert watch(judge, simulation, 3.0) == []
    assert simulation.in_play.all()
    assert not judge.loose().any()


def test_an_empty_cell_has_no_events(simulation: Simulation, judge: DeliveryJudge) -> None:
    assert watch(judge, simulation, 0.5) == []


def test_several_fates_at_once(simulation: Simulation, judge: DeliveryJudge) -> None:
    simulation.place(0, above_tray(simulation))
    simulation.place(1, centred(simulation, TABLE))
    simulation.place(2, centred(simulation, (0.5, 0.0, 0.08)))
    assert kinds(watch(judge, simulation, 4.0)) == {0: Delivery.DELIVERED, 1: Delivery.LEFT_BIN}
    np.testing.assert_array_equal(simulation.in_play, [False, False, True, False, False])


def test_the_kinds_are_words() -> None:
    assert [str(kind) for kind in Delivery] == ["delivered", "double", "unreleased", "left_bin"]
