"""What the scripted picker does not attempt, for a reason that it names."""

import numpy as np
import pytest

from binpick_env.config import BinConfig, CellConfig
from policies.grasping.outcomes import Abstention, GraspOutcome
from tests.policies.hand_cell import HandCell, Shifted, assert_abstains, hand_cell, lie


def test_an_empty_bin_has_no_candidate(tees: HandCell) -> None:
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


def test_a_part_on_which_something_lies_is_picked_at_a_second_look_only(tees: HandCell) -> None:
    tees.lay(tees.flat())
    capture = tees.env.capture
    assert capture is not None
    part = capture.instance_ids == 0
    half = part & (np.cumsum(part, axis=1) > 0.4 * part.sum(axis=1, keepdims=True))
    tees.see(np.where(half, capture.frame.depth - 0.008, capture.frame.depth))
    assert max(grasp.features["buried"] for grasp in tees.picker.grasps()) > tees.picker.settings.most_buried
    assert_abstains(tees, Abstention.NO_CLEAR_APPROACH)
    assert tees.picker.pick().outcome is GraspOutcome.DELIVERED


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


@pytest.mark.slow
def test_a_bin_out_of_reach_is_infeasible() -> None:
    cell = hand_cell("tee", 1, config=CellConfig(bin=BinConfig(position=(1.4, 0.0))))
    cell.lay(cell.flat())
    assert_abstains(cell, Abstention.IK_INFEASIBLE)
    assert cell.picker.rank_stats.clear > 0


@pytest.mark.slow
def test_a_part_that_is_said_to_lie_two_metres_away_is_infeasible(
    tees: HandCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    lie(monkeypatch, tees, Shifted((2.0, 0.0, 0.0)))
    tees.lay(tees.flat())
    assert_abstains(tees, Abstention.NO_CLEAR_APPROACH)  # nothing of it was measured: it counts as buried
    assert_abstains(tees, Abstention.IK_INFEASIBLE)
