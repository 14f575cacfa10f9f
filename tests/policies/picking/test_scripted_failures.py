"""Attempts of the scripted picker that fail on the real physics: every fault ends as it is named."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from binpick_env.cell.delivery import Delivery
from perception.geometry import Floats, make_transform, rotation_angle
from policies.grasping.clearance import RankSettings
from policies.grasping.outcomes import Abstention, GraspOutcome
from policies.motion.planner import MotionPlan, MotionPlanner, PlanFailure
from policies.picking.execution import ExecutionSettings
from policies.picking.scripted import ScriptedPicker
from policies.picking.settings import PickerSettings
from tests.policies.hand_cell import HandCell, Shifted, assert_abstains, assert_fails, greased, lie

pytestmark = pytest.mark.slow

STOP_FORCE = ExecutionSettings().stop_force
ASIDE = (0.0, 0.06, 0.0)  # world: half a tee beside where it is [m]
Where = Callable[[float, float], bool]


@pytest.mark.parametrize("shift", [ASIDE, (-0.06, 0.0, 0.0), (0.0, 0.0, 0.05)])
def test_a_part_that_is_not_where_it_is_said_to_be_is_missed(
    tees: HandCell, monkeypatch: pytest.MonkeyPatch, shift: tuple[float, float, float]
) -> None:
    lie(monkeypatch, tees, Shifted(shift))
    tees.lay(tees.flat())
    before = tees.env.simulation.part_centres()[0]
    assert_fails(tees, GraspOutcome.MISSED)
    np.testing.assert_allclose(tees.env.simulation.part_centres()[0], before, atol=0.01)
    highest = max(step.height for step in tees.log)
    assert highest < 0.5  # from the bin it goes home, not over the tray and back


def test_after_a_miss_another_part_comes_first_and_then_another_grasp(
    tees: HandCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    lie(monkeypatch, tees, Shifted((0.0, 0.06, 0.06), parts=(0,)))  # much higher: all its grasps rank first
    tees.lay(tees.flat(0.05, -0.03), tees.flat(-0.1, 0.03))
    picks = [tees.picker.pick() for _ in range(3)]
    assert [pick.part for pick in picks] == [0, 1, 0]
    assert [pick.outcome for pick in picks] == [GraspOutcome.MISSED, GraspOutcome.DELIVERED, GraspOutcome.MISSED]
    first, again = (pick.grasp.T_world_grasp for pick in picks[::2] if pick.grasp is not None)
    tips = float(np.linalg.norm(first[:3, 3] - again[:3, 3]))
    turn = min(rotation_angle(first[:3, :3].T @ again[:3, :3] @ np.diag([s, s, 1.0])) for s in (1, -1))
    assert tips > 0.008 or turn > np.radians(15)


def test_a_part_whose_only_grasp_has_failed_is_left_alone(tees: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    picker = ScriptedPicker(tees.env, PickerSettings(rank=RankSettings(per_candidate=1)))
    lie(monkeypatch, tees, Shifted(ASIDE))
    monkeypatch.setattr(tees, "picker", picker)
    tees.lay(tees.flat())
    assert_fails(tees, GraspOutcome.MISSED)
    tees.log.clear()
    assert_abstains(tees, Abstention.NO_CLEAR_APPROACH)
    picker.reset()
    assert_fails(tees, GraspOutcome.MISSED)


def test_a_reset_forgets_where_an_attempt_failed(tees: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    lie(monkeypatch, tees, Shifted((0.0, 0.06, 0.06), parts=(0,)))
    tees.lay(tees.flat(0.05, -0.03), tees.flat(-0.1, 0.03))
    assert tees.picker.pick().part == 0
    tees.picker.reset()
    assert tees.picker.pick().part == 0


@pytest.mark.parametrize("yaw", [0.0, np.pi / 2])
def test_what_the_frame_did_not_show_breaks_the_descent_off(wheels: HandCell, yaw: float) -> None:
    wheels.lay(wheels.flat(), unseen=[wheels.flat(yaw=yaw, above=wheels.thickness + 0.001)])
    assert_fails(wheels, GraspOutcome.COLLIDED)
    forces = np.array([step.force for step in wheels.log])
    hit = int(np.argmax(forces > STOP_FORCE))
    assert forces[:hit].max() <= STOP_FORCE
    assert forces[hit] > STOP_FORCE
    assert forces.max() < 10 * STOP_FORCE  # it is felt once a control period, in which the arm moves some 13 mm
    assert forces[hit + 3 :].max() < STOP_FORCE  # it leaves without pushing on
    assert all(step.action[6] < 1.0 for step in wheels.log)  # and never closes the jaw
    heights = np.array([step.height for step in wheels.log])
    assert heights[hit:].min() > heights[hit] - 0.015
    assert wheels.env.remaining == 2


def test_two_lids_in_one_jaw_are_a_double(lids: HandCell) -> None:
    lids.lay(lids.flat(), unseen=[lids.flat(above=lids.thickness + 0.001)])
    assert_fails(lids, GraspOutcome.DOUBLE)
    assert sorted((e.part, e.kind) for e in lids.env.events) == [(0, Delivery.DOUBLE), (1, Delivery.DOUBLE)]
    assert (lids.env.delivered, lids.env.remaining) == (0, 0)


def test_one_of_two_lids_alone_is_no_double(lids: HandCell) -> None:
    lids.lay(lids.flat(0.1), unseen=[lids.flat(-0.1)])
    assert lids.picker.pick().outcome is GraspOutcome.DELIVERED
    assert (lids.env.delivered, lids.env.remaining) == (1, 1)


def test_a_greasy_part_slips_out_of_the_jaw_and_the_empty_jaw_goes_home(
    wheels: HandCell,
) -> None:
    wheels.lay(wheels.flat())
    with greased(wheels):
        assert_fails(wheels, GraspOutcome.SLIPPED)
    assert wheels.env.remaining == 1
    assert wheels.env.workspace.contains(wheels.env.simulation.part_centres()[:1]).all()


LIFTING: Where = lambda rise, across: rise > 0.03  # noqa: E731
CARRYING: Where = lambda rise, across: across > 0.02  # noqa: E731


def fault_from(cell: HandCell, where: Where, act: Callable[[Floats], None]) -> None:
    """Call ``act`` on every action with a closed jaw from where the tcp has moved so far [m] since the jaw closed."""
    closed_at: list[Floats] = []

    def fault(action: Floats) -> Floats:
        position = cell.env.simulation.T_world_tcp[:3, 3]
        if action[6] == 1.0:
            closed_at.append(position)
            across = float(np.linalg.norm((position - closed_at[0])[:2]))
            if where(float((position - closed_at[0])[2]), across):
                act(action)
        return action

    cell.fault = fault


def open_jaw(action: Floats) -> None:
    action[6] = 0.0


def test_a_jaw_that_opens_over_the_bin_drops_the_part_into_it(tees: HandCell) -> None:
    tees.lay(tees.flat())
    fault_from(tees, CARRYING, open_jaw)
    assert_fails(tees, GraspOutcome.DROPPED, frames=2)  # the first one shows a bin that has changed since
    assert (tees.env.events, tees.env.remaining) == ([], 1)
    assert tees.env.workspace.contains(tees.env.simulation.part_centres()[:1]).all()


def test_a_jaw_that_opens_during_the_lift_lets_the_part_slip(tees: HandCell) -> None:
    tees.lay(tees.flat())
    fault_from(tees, LIFTING, open_jaw)
    assert_fails(tees, GraspOutcome.SLIPPED)
    assert tees.env.remaining == 1


def test_a_part_that_vanishes_on_the_way_is_dropped(tees: HandCell) -> None:
    tees.lay(tees.flat(), tees.flat(-0.1))
    simulation = tees.env.simulation
    fault_from(tees, CARRYING, lambda _: [simulation.park(part) for part in simulation.gripped()] and None)
    assert_fails(tees, GraspOutcome.DROPPED)
    assert (tees.env.events, tees.env.remaining) == ([], 1)


def test_a_part_that_falls_on_the_table_has_left_the_bin(tees: HandCell) -> None:
    tees.lay(tees.flat(), tees.flat(-0.1))
    simulation = tees.env.simulation
    T_world_part = make_transform(translation=(0.2, 0.5, 0.03))
    fault_from(tees, CARRYING, lambda _: [simulation.place(i, T_world_part) for i in simulation.gripped()] and None)
    assert_fails(tees, GraspOutcome.LEFT_BIN)
    assert [event.kind for event in tees.env.events] == [Delivery.LEFT_BIN]
    assert (tees.env.delivered, tees.env.remaining) == (0, 1)


def test_an_attempt_waits_for_the_judgement_of_what_it_released(tees: HandCell) -> None:
    tees.lay(tees.flat(), tees.flat(-0.1))
    simulation, held = tees.env.simulation, []

    def move_when_let_go(action: Floats) -> Floats:
        if action[6] == 1.0:
            held[:] = simulation.gripped() or held
        elif held:  # a second must pass before it counts as lost, longer than the way home
            simulation.place(held.pop(), make_transform(translation=(0.2, 0.5, 0.03)))
        return action

    tees.fault = move_when_let_go
    assert_fails(tees, GraspOutcome.LEFT_BIN)


def test_a_part_too_large_for_the_way_is_carried_home_which_is_above_the_tray(
    tees: HandCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    tees.lay(tees.flat())
    plan_transfer, plans, gaps = MotionPlanner.plan_transfer, [], []

    def not_with_the_part(*args: Any, **options: Any) -> MotionPlan:
        plans.append("scale" in options)
        gaps.append(float(np.abs(args[1] - tees.env.simulation.target).max()))
        return MotionPlan(failure=PlanFailure.COLLISION) if plans[-1] else plan_transfer(*args, **options)

    monkeypatch.setattr(MotionPlanner, "plan_transfer", not_with_the_part)
    assert tees.picker.pick().outcome is GraspOutcome.DELIVERED
    assert plans.count(True) == 1
    assert max(gaps) < 0.01  # every motion begins where the arm is


def test_a_picker_that_finds_no_way_with_the_part_lets_it_go_and_retraces(
    tees: HandCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    tees.lay(tees.flat())
    plan_transfer, plans = MotionPlanner.plan_transfer, []

    def only_the_approach(*args: Any, **options: Any) -> MotionPlan:
        plans.append(plan_transfer(*args, **options))
        return plans[-1] if args[4].standoff > 0 else MotionPlan(failure=PlanFailure.COLLISION)

    monkeypatch.setattr(MotionPlanner, "plan_transfer", only_the_approach)
    result = tees.picker.pick()
    assert not result.success
    assert tees.at_home
    assert tees.env.workspace.contains(tees.env.simulation.part_centres()[:1]).all()
    assert [plan.ok for plan in plans][-3:] == [True] * 3  # towards the part, with it to the tray, home
    closed = [n for n, step in enumerate(tees.log) if step.action[6] == 1.0]
    way_in = np.stack([step.target for step in tees.log[: closed[0]]])
    way_out = np.stack([step.target for step in tees.log[-len(way_in) :]])
    np.testing.assert_allclose(way_out[:-1], way_in[-2::-1], atol=1e-6)


def test_a_part_that_was_lost_before_is_not_this_attempts(tees: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    lie(monkeypatch, tees, Shifted(ASIDE, parts=(0,)))
    beside = tees.flat(0.0, 0.45)  # on the table
    tees.lay(tees.flat(), unseen=[beside])
    result = tees.picker.pick()
    assert result.outcome is GraspOutcome.MISSED
    assert [event.kind for event in tees.env.events] == [Delivery.LEFT_BIN]
