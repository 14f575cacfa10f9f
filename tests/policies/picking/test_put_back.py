"""Two parts in one jaw are found by their weight and put back, on the real physics."""

from dataclasses import replace

import pytest

from policies.grasping.outcomes import GraspOutcome
from policies.picking.extra_decisions import PER_PART
from policies.picking.load_check import DoubleSettings
from policies.picking.scripted import T_SENSE, ScriptedPicker
from policies.picking.settings import PickerSettings
from tests.policies.hand_cell import HandCell
from tests.policies.picking.weighings import weigh_as

pytestmark = pytest.mark.slow
PUT_BACK = PickerSettings()


@pytest.fixture
def careful(lids: HandCell, monkeypatch: pytest.MonkeyPatch) -> HandCell:
    """Return the lids' cell with a picker that puts doubles back."""
    monkeypatch.setattr(lids, "picker", ScriptedPicker(lids.env, PUT_BACK))
    return lids


def lay_two(cell: HandCell) -> None:
    """Lay a lid with another one on it, which no frame shows; both come along."""
    cell.lay(cell.flat(), unseen=[cell.flat(above=cell.thickness + 0.001)])
    for _ in range(10):  # a put-back must be at most a fifth of the decisions
        cell.picker._extra.decided()


def let_go_height(cell: HandCell) -> float:
    """Return the height of the tcp when the jaw was last told to be closed [m]."""
    return [step.height for step in cell.log if step.action[6] == 1.0][-1]


def test_two_lids_are_put_back_and_stay_in_the_bin_where_they_are_tried_last(careful: HandCell) -> None:
    lay_two(careful)
    result = careful.picker.pick()
    assert (result.outcome, result.delivered, result.success) == (GraspOutcome.PUT_BACK, 0, False)
    check = result.double_check
    assert check is not None
    assert (check.weight, check.held) == (True, 2)
    assert check.load == pytest.approx(2.0, abs=0.45)
    env = careful.env
    assert (env.events, env.remaining) == ([], 2)
    assert env.workspace.contains(env.simulation.part_centres()).all()
    assert careful.at_home
    assert let_go_height(careful) < 0.15  # lowered, not dropped from the lift
    centres = env.simulation.part_centres()
    assert all(careful.picker.failed.suspect(centre) for centre in centres)
    careful.picker._extra.moved(centres[0], centres[0])
    assert not careful.picker._extra.allows(centres[0])  # a third time


def test_a_lone_lid_is_no_double(careful: HandCell) -> None:
    careful.lay(careful.flat())
    result = careful.picker.pick()
    assert result.outcome is GraspOutcome.DELIVERED
    assert result.double_check is not None
    assert (result.double_check.weight, result.double_check.jaw, result.double_check.held) == (False, False, 1)
    assert (result.double_check.image, result.t_sense) == (None, T_SENSE)  # its weight is enough


def test_where_nothing_is_put_back_a_double_is_found_and_goes_to_the_tray(
    lids: HandCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lids, "picker", ScriptedPicker(lids.env, PUT_BACK.attempts_only()))
    lay_two(lids)
    result = lids.picker.pick()
    assert result.outcome is GraspOutcome.DOUBLE
    assert result.double_check is not None
    assert (result.double_check.weight, result.double_check.held) == (True, 2)


def test_a_detector_that_is_switched_off_puts_nothing_back(careful: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = replace(PUT_BACK, doubles=DoubleSettings(weight=False))
    monkeypatch.setattr(careful, "picker", ScriptedPicker(careful.env, settings))
    lay_two(careful)
    assert careful.picker.pick().outcome is GraspOutcome.DOUBLE


def test_the_first_decision_of_a_small_bin_puts_nothing_back(careful: HandCell) -> None:
    careful.lay(careful.flat(), unseen=[careful.flat(above=careful.thickness + 0.001)])
    assert careful.picker.pick().outcome is GraspOutcome.DOUBLE


def test_where_no_way_leads_back_the_load_is_let_go_above_the_bin(
    careful: HandCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(careful.picker._planner, "put_back", lambda *_: None)
    lay_two(careful)
    result = careful.picker.pick()
    assert result.outcome is GraspOutcome.PUT_BACK
    assert careful.env.delivered == 0


def test_a_load_that_is_one_part_after_all_is_delivered(careful: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second part that leaned on the first has fallen off when the load is weighed at rest."""
    answers = weigh_as(monkeypatch, True, False)
    careful.lay(careful.flat(), careful.flat(0.1))
    for _ in range(10):
        careful.picker._extra.decided()
    assert careful.picker.pick().outcome is GraspOutcome.DELIVERED
    assert next(answers, None) is None  # it was weighed twice


@pytest.mark.parametrize(("distance", "left"), [(0.9, {1}), (1.1, {0, 1})])
def test_parts_that_were_put_back_twice_are_left_unless_they_lie_apart(
    careful: HandCell, distance: float, left: set[int]
) -> None:
    careful.lay(careful.flat(), careful.flat(distance * careful.env.part.model.d_max, 0.0))
    centres = [candidate.centre_world for candidate in careful.env.candidates]
    assert {grasp.candidate for grasp in careful.picker.grasps()} == {0, 1}
    for _ in range(PER_PART):
        careful.picker._extra.put_back(centres[0], centres[0])
    assert {grasp.candidate for grasp in careful.picker.grasps()} == left


def test_parts_that_were_put_back_together_before_fall_further(careful: HandCell) -> None:
    lay_two(careful)
    centre = careful.env.candidates[0].centre_world
    careful.picker._extra.put_back(centre, centre)
    careful.picker._extra.decisions = 20
    assert careful.picker.pick().outcome is GraspOutcome.PUT_BACK
    assert let_go_height(careful) > 0.17
    assert careful.env.workspace.contains(careful.env.simulation.part_centres()).all()
