"""The scripted picker on the real physics: parts laid by hand are picked, bins emptied, and no truth is read."""

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from binpick_env.cell.delivery import Delivery
from binpick_env.cell.scene import parking_poses
from binpick_env.parts.catalogue import CATALOGUE
from policies.grasping.outcomes import Abstention, GraspOutcome
from policies.picking.episode import BinResult, Termination, run_bin
from policies.picking.scripted import T_SENSE
from tests.last_frame import change_frame
from tests.policies.hand_cell import (
    SMALL_BIN,
    Blind,
    HandCell,
    Nameless,
    Shifted,
    decision,
    greased,
    hand_cell,
    lie,
    noisy,
)

SLOW = pytest.mark.slow


def play(cell: HandCell, seed: int, num_parts: int = SMALL_BIN) -> tuple[BinResult, np.ndarray]:
    """Pick a whole bin; return its result and the (S, 7) actions that were sent."""
    cell.fault = None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cell.env, "_num_parts", (num_parts, num_parts))
        cell.log.clear()
        result = run_bin(cell.env, cell.picker, seed)
    return result, np.stack([step.action for step in cell.log])


# --- recovery --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("part", ["tee", *(pytest.param(part, marks=SLOW) for part in CATALOGUE if part != "tee")])
def test_a_part_laid_flat_in_the_middle_is_delivered_and_parked(part: str) -> None:
    cell = hand_cell(part, 1)
    env = cell.env
    cell.lay(cell.flat(yaw=0.4))
    assert env.frame_id == 1  # the reset's frame, and the one of the parts laid
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
@pytest.mark.parametrize(("place", "yaw"), [((-0.1, -0.05), 1.1), ((0.13, 0.08), 0.0), ((0.13, 0.08), 2.2)])
def test_a_part_anywhere_in_the_bin_is_delivered(tees: HandCell, place: tuple[float, float], yaw: float) -> None:
    tees.lay(tees.flat(*place, yaw=yaw))
    assert tees.picker.pick().outcome is GraspOutcome.DELIVERED


@pytest.mark.slow
def test_a_pose_that_is_two_millimetres_off_is_good_enough(tees: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    lie(monkeypatch, tees, noisy(0.002))
    for seed in range(2):
        tees.lay(tees.flat(yaw=0.8 * seed), seed=seed)
        assert tees.picker.pick().outcome is GraspOutcome.DELIVERED


# --- end to end ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_small_bin_is_emptied_but_for_one_part_at_most(tees: HandCell) -> None:
    result, _ = play(tees, 101)
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
    assert play(cell, 101, num_parts=4)[0].delivered >= 3


@pytest.mark.slow
def test_the_same_bin_is_picked_the_same_way_twice(tees: HandCell) -> None:
    first, first_actions = play(tees, 101, num_parts=2)
    again, again_actions = play(tees, 101, num_parts=2)
    other, other_actions = play(hand_cell("tee", SMALL_BIN), 101, num_parts=2)
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


def test_two_frames_without_a_candidate_end_a_bin(tees: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    lie(monkeypatch, tees, Blind())
    with monkeypatch.context() as patch:
        patch.setattr(tees.env, "_num_parts", (2, 2))
        result = run_bin(tees.env, tees.picker, 101)
    assert [pick.abstention for pick in result.picks] == [Abstention.NO_CANDIDATE] * 2
    assert [pick.frame_id for pick in result.picks] == [0, 1]
    assert (result.termination, tees.env.frame_id) == (Termination.ABSTAINED, 1)


# --- what it must not know -------------------------------------------------------------------------------------------


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("grease", [pytest.param(False, marks=SLOW), True])
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

    for question in ("part_poses", "part_centres", "part_speeds", "asleep", "gripped", "touched_by_robot"):
        monkeypatch.setattr(tees.env.simulation, question, forbidden)
    nothing = {name: np.zeros(0) for name in ("instance_ids", "depth_true", "normals")}
    change_frame(tees.env, labelled_capture=SimpleNamespace(capture=replace(tees.env.capture, **nothing)))
    with pytest.raises(AssertionError, match="asked for the truth"):  # after the plan, to judge the attempt by
        tees.picker.pick()
    assert tees.picker.rank_stats.clear > 0
    assert tees.env.simulation.time > 0.39
