"""The scripted picker on the real physics: parts laid by hand are picked, and every fault ends as it is named."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hand_cell import Blind, HandCell, Nameless, Shifted, decision, hand_cell, noisy

from binpick_env.config import BinConfig, CellConfig
from binpick_env.outcomes import Delivery
from binpick_env.parts.catalogue import CATALOGUE
from binpick_env.perceiver import Perceiver
from binpick_env.scene import parking_poses
from perception.geometry import Floats, make_transform, rotation_angle
from policies.clearance import RankSettings
from policies.episode import BinResult, Termination, run_bin
from policies.execution import ExecutionSettings
from policies.outcomes import Abstention, GraspOutcome, PickResult
from policies.planner import MotionPlan, MotionPlanner, PlanFailure
from policies.scripted import T_SENSE, PickerSettings, ScriptedPicker

STOP_FORCE = ExecutionSettings().stop_force
SLOW = pytest.mark.slow
ASIDE = (0.0, 0.06, 0.0)  # world: half a tee beside where it is [m]
SMALL_BIN = 6
Where = Callable[[float, float], bool]


@pytest.fixture(scope="module")
def tees() -> HandCell:
    return hand_cell("tee", SMALL_BIN)


@pytest.fixture(scope="module")
def lids() -> HandCell:
    return hand_cell("part_b")


@pytest.fixture(scope="module")
def wheels() -> HandCell:
    return hand_cell("part_a")


def lie(monkeypatch: pytest.MonkeyPatch, cell: HandCell, perceiver: Perceiver) -> None:
    monkeypatch.setattr(cell.env, "_perceiver", perceiver)


def play(cell: HandCell, seed: int, num_parts: int = SMALL_BIN) -> tuple[BinResult, np.ndarray]:
    """Pick a whole bin; return its result and the (S, 7) actions that were sent."""
    cell.fault = None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cell.env, "_num_parts", (num_parts, num_parts))
        cell.log.clear()
        result = run_bin(cell.env, cell.picker, seed)
    return result, np.stack([step.action for step in cell.log])


@contextmanager
def greased(cell: HandCell) -> Iterator[None]:
    friction = cell.env.simulation.model.geom_friction
    usual = friction.copy()
    friction[:] = 1e-4
    try:
        yield
    finally:
        friction[:] = usual


def assert_abstains(cell: HandCell, reason: Abstention) -> PickResult:
    """Pick, and check that nothing was moved for a reason."""
    frame_id, perception = cell.env.frame_id, cell.env.perception_time
    result = cell.picker.pick()
    assert (result.outcome, result.abstention) == (None, reason)
    assert (result.grasp, result.delivered, result.part) == (None, 0, -1)
    assert (result.t_motion, result.t_sense, result.frame_id) == (0.0, T_SENSE, frame_id)
    assert result.t_compute >= perception
    assert cell.log == []
    return result


def assert_fails(cell: HandCell, outcome: GraspOutcome, *, frames: int = 1) -> PickResult:
    """Pick, and check that it fails as named, and that the arm is home with the jaw open and the next frame taken."""
    frame_id = cell.env.frame_id
    result = cell.picker.pick()
    assert (result.outcome, result.abstention) == (outcome, None)
    assert not result.success
    assert result.delivered == 0
    assert result.t_motion > 1.0
    assert result.frame_id == frame_id
    assert cell.env.frame_id == frame_id + frames
    assert cell.at_home
    return result


# --- recovery --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", CATALOGUE)
def test_a_part_laid_flat_in_the_middle_is_delivered_and_parked(part: str) -> None:
    cell = hand_cell(part, 1)
    env = cell.env
    cell.lay(cell.flat(yaw=0.4))
    assert env.frame_id == 1  # the reset's, and the look at what was laid
    result = cell.picker.pick()
    assert result.outcome is GraspOutcome.DELIVERED
    assert result.success
    assert (result.delivered, result.part, result.frame_id) == (1, 0, 1)
    assert env.frame_id == 2
    assert [(event.part, event.kind) for event in env.events] == [(0, Delivery.DELIVERED)]
    assert (env.delivered, env.remaining) == (1, 0)
    np.testing.assert_allclose(env.simulation.part_poses()[0], parking_poses(1)[0], atol=1e-9)
    assert cell.at_home
    assert result.t_sense == T_SENSE == 0.5
    assert 2.0 < result.t_motion < 6.0  # 550 an hour allow 6.5 s for everything
    assert result.t_motion == pytest.approx(len(cell.log) * 0.04, abs=1e-6)
    assert 0.0 < result.t_compute < 20.0
    assert result.grasp is not None
    np.testing.assert_allclose(result.grasp.T_world_grasp[:2, 3], env.workspace.T_world_bin[:2, 3], atol=0.045)
    assert cell.picker.rank_stats.clear > 0


@pytest.mark.slow
@pytest.mark.parametrize("yaw", [0.0, 1.1, 2.2])
@pytest.mark.parametrize("place", [(-0.1, -0.05), (0.13, 0.08)])
def test_a_part_anywhere_in_the_bin_is_delivered(tees: HandCell, place: tuple[float, float], yaw: float) -> None:
    tees.lay(tees.flat(*place, yaw=yaw))
    assert tees.picker.pick().outcome is GraspOutcome.DELIVERED


def test_a_pose_that_is_two_millimetres_off_is_good_enough(tees: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    lie(monkeypatch, tees, noisy(0.002))
    for seed in range(2):
        tees.lay(tees.flat(yaw=0.8 * seed), seed=seed)
        assert tees.picker.pick().outcome is GraspOutcome.DELIVERED


# --- end to end ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [101, pytest.param(102, marks=SLOW)])
def test_a_small_bin_is_emptied_but_for_one_part_at_most(tees: HandCell, seed: int) -> None:
    result, _ = play(tees, seed)
    assert result.parts_total == SMALL_BIN
    assert result.delivered >= SMALL_BIN - 1
    assert result.delivered == sum(pick.delivered for pick in result.picks) == tees.env.delivered
    assert (result.termination is Termination.EMPTY) == (tees.env.remaining == 0)
    ids = [pick.frame_id for pick in result.picks]
    assert ids == list(range(len(ids)))  # one frame for each decision


@pytest.mark.slow
@pytest.mark.parametrize("part", ["part_a", "part_b", "part_c", "bracket"])
def test_small_bins_of_the_other_parts(part: str) -> None:
    cell = hand_cell(part, 4)
    assert sum(play(cell, seed, num_parts=4)[0].delivered for seed in (101, 102)) >= 7


@pytest.mark.slow
def test_the_same_bin_is_picked_the_same_way_twice(tees: HandCell) -> None:
    first, first_actions = play(tees, 101, num_parts=3)
    again, again_actions = play(tees, 101, num_parts=3)
    other, other_actions = play(hand_cell("tee", SMALL_BIN), 101, num_parts=3)
    for result, actions in ((again, again_actions), (other, other_actions)):
        assert [decision(pick) for pick in result.picks] == [decision(pick) for pick in first.picks]
        np.testing.assert_array_equal(actions, first_actions)
    assert not np.array_equal(play(tees, 102, num_parts=1)[1][:50], first_actions[:50])


def test_two_misses_end_a_bin(tees: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    lie(monkeypatch, tees, Shifted((0.0, 0.0, 0.1)))  # the parts are said to hover: the jaw closes on air
    result, _ = play(tees, 101, num_parts=1)
    assert [pick.outcome for pick in result.picks] == [GraspOutcome.MISSED] * 2
    assert result.termination is Termination.TWO_FAILURES
    assert tees.env.remaining == 1


def test_nothing_seen_twice_ends_a_bin_after_one_more_look(tees: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    lie(monkeypatch, tees, Blind())
    with monkeypatch.context() as patch:
        patch.setattr(tees.env, "_num_parts", (2, 2))
        result = run_bin(tees.env, tees.picker, 101)
    assert [pick.abstention for pick in result.picks] == [Abstention.NO_CANDIDATE] * 2
    assert [pick.frame_id for pick in result.picks] == [0, 1]
    assert (result.termination, tees.env.frame_id) == (Termination.ABSTAINED, 1)


# --- what it must not know -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("seed", "error"), [(101, 0.008), pytest.param(102, 0.012, marks=SLOW)])
def test_the_true_index_of_a_part_changes_nothing(
    tees: HandCell, monkeypatch: pytest.MonkeyPatch, seed: int, error: float
) -> None:
    lie(monkeypatch, tees, noisy(error))  # such errors make some attempts fail, which the picker remembers
    named, named_actions = play(tees, seed, num_parts=4)
    lie(monkeypatch, tees, Nameless(noisy(error)))
    nameless, actions = play(tees, seed, num_parts=4)
    assert {pick.part for pick in nameless.picks} == {-1}
    assert any(pick.part >= 0 for pick in named.picks)
    assert [decision(pick) for pick in nameless.picks] == [decision(pick) for pick in named.picks]
    np.testing.assert_array_equal(actions, named_actions)


@pytest.mark.parametrize("grease", [False, True])
def test_what_the_jaw_truly_holds_names_the_outcome_and_moves_nothing(
    wheels: HandCell, monkeypatch: pytest.MonkeyPatch, grease: bool
) -> None:
    outcomes, moved = [], []
    for truth in (True, False):
        if not truth:
            monkeypatch.setattr(wheels.env.simulation, "gripped", frozenset)
        wheels.lay(wheels.flat())
        with greased(wheels) if grease else nullcontext():
            outcomes.append(wheels.picker.pick().outcome)
        moved.append(np.stack([step.action for step in wheels.log]))
    delivered = [GraspOutcome.DELIVERED] * 2
    assert outcomes == ([GraspOutcome.SLIPPED, GraspOutcome.MISSED] if grease else delivered)
    np.testing.assert_array_equal(*moved)


def test_a_decision_reads_no_truth(tees: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    tees.lay(tees.flat())

    def forbidden(*_: object) -> None:
        raise AssertionError("the picker asked for the truth")

    for question in ("part_poses", "part_centres", "part_speeds", "asleep", "gripped", "touched_by_gripper"):
        monkeypatch.setattr(tees.env.simulation, question, forbidden)
    capture = tees.env.capture
    assert capture is not None
    nothing = {name: np.zeros(0) for name in ("instance_ids", "depth_true", "normals")}
    tees.env.capture = replace(capture, **nothing)  # type: ignore[arg-type]
    monkeypatch.setattr(tees.env, "view", None)
    with pytest.raises(AssertionError, match="asked for the truth"):  # only by the physics, in the first step
        tees.picker.pick()
    assert tees.picker.rank_stats.clear > 0
    assert tees.env.simulation.time > 0.39


# --- abstentions -----------------------------------------------------------------------------------------------------


def test_an_empty_bin_offers_no_candidate(tees: HandCell) -> None:
    tees.lay()
    assert tees.env.candidates == []
    assert_abstains(tees, Abstention.NO_CANDIDATE)


def test_a_part_in_a_pit_has_no_clear_approach(tees: HandCell) -> None:
    tees.lay(tees.flat())
    capture = tees.env.capture
    assert capture is not None
    raised = np.where(capture.instance_ids < 0, capture.frame.depth - 0.1, capture.frame.depth)
    tees.see(raised)
    assert_abstains(tees, Abstention.NO_CLEAR_APPROACH)
    assert tees.picker.rank_stats.parts_blocked == 1
    assert tees.picker.rank_stats.blocked > 0


@pytest.mark.parametrize("depth", [0.0, np.nan, np.inf, -0.9])
def test_nothing_is_entered_on_a_frame_without_depth(tees: HandCell, depth: float) -> None:
    tees.lay(tees.flat())
    tees.see(np.array(depth))
    assert_abstains(tees, Abstention.NO_CLEAR_APPROACH)


def test_a_frame_that_has_lost_four_fifths_of_its_pixels_is_good_enough(tees: HandCell) -> None:
    tees.lay(tees.flat())
    lost = np.random.default_rng(0).random(tees.env.frame.depth.shape) < 0.8
    tees.see(np.where(lost, np.nan, tees.env.frame.depth))
    assert tees.picker.pick().outcome is GraspOutcome.DELIVERED


def test_a_bin_out_of_reach_is_infeasible() -> None:
    cell = hand_cell("tee", 1, config=CellConfig(bin=BinConfig(position=(1.4, 0.0))))
    cell.lay(cell.flat())
    assert_abstains(cell, Abstention.IK_INFEASIBLE)
    assert cell.picker.rank_stats.clear > 0


def test_a_part_that_is_said_to_lie_two_metres_away_is_infeasible(
    tees: HandCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    lie(monkeypatch, tees, Shifted((2.0, 0.0, 0.0)))
    tees.lay(tees.flat())
    assert_abstains(tees, Abstention.IK_INFEASIBLE)


# --- failures of an attempt ------------------------------------------------------------------------------------------


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
    assert_fails(tees, GraspOutcome.DROPPED)
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
        return plans[-1] if options.get("standoff", 0) > 0 else MotionPlan(failure=PlanFailure.COLLISION)

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
