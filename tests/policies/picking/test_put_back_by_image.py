"""Light parts, of which the wrist cannot tell one from two, are told by an image of the bin, on the real physics."""

from collections.abc import Iterator

import pytest

from policies.grasping.outcomes import GraspOutcome, PickResult
from policies.picking.load_check import DoubleSettings
from policies.picking.scripted import T_SENSE, ScriptedPicker
from policies.picking.settings import PickerSettings
from tests.policies.hand_cell import HandCell, hand_cell
from tests.policies.picking.weighings import weigh_as

pytestmark = pytest.mark.slow
LID_DENSITY = 500.0  # [kg/m^3]: 15 g


@pytest.fixture(scope="module")
def light_lids() -> Iterator[HandCell]:
    cell = hand_cell("part_b", density=LID_DENSITY)
    yield cell
    cell.env.close()


def pick(cell: HandCell, *, along: bool, spare: int = 10) -> PickResult:
    """Pick one of two lids that lie apart; the other one leaves the bin, too, if it is to come along."""
    cell.lay(cell.flat(-0.09), cell.flat(0.09))
    for _ in range(spare):  # a put-back must be at most a fifth of the decisions
        cell.picker._extra.decided()
    simulation = cell.env.simulation

    def take_the_other(action):  # type: ignore[no-untyped-def]
        lifted = simulation.part_centres()[:2, 2] > 0.12
        if along and lifted.sum() == 1 and simulation.in_play[:2].all():
            simulation.park(1 - int(lifted.argmax()))
        return action

    cell.fault = take_the_other
    return cell.picker.pick()


def test_a_load_that_left_one_place_is_delivered(light_lids: HandCell) -> None:
    result = pick(light_lids, along=False)
    check = result.double_check
    assert check is not None
    assert (result.outcome, check.image, check.held) == (GraspOutcome.DELIVERED, False, 1)
    assert check.gone == pytest.approx(0.0, abs=0.1)
    assert result.t_sense == 2 * T_SENSE


def test_a_load_that_left_two_places_is_put_back_from_over_the_tray(light_lids: HandCell) -> None:
    result = pick(light_lids, along=True)
    check = result.double_check
    assert check is not None
    assert check.image
    assert check.gone == pytest.approx(1.5, abs=0.6)
    assert (result.outcome, result.t_sense, result.delivered) == (GraspOutcome.PUT_BACK, 2 * T_SENSE, 0)
    closed = [step.height for step in light_lids.log if step.action[6] == 1.0]
    assert closed[-1] < 0.15  # lowered all the way, not dropped from the height of the carry
    env = light_lids.env
    assert (env.events, env.remaining) == ([], 1)
    held = env.simulation.part_centres()[env.simulation.in_play]
    assert env.workspace.contains(held).all()
    assert light_lids.at_home


def test_an_image_decides_too_where_the_weight_at_rest_is_undecided(
    light_lids: HandCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The load seemed to be two at the end of the lift, and may be one when it is weighed again."""
    answers = weigh_as(monkeypatch, True, False)
    result = pick(light_lids, along=True)
    assert next(answers, None) is None
    assert result.double_check is not None
    assert (result.outcome, result.double_check.image) == (GraspOutcome.PUT_BACK, True)


def test_no_image_is_taken_where_nothing_may_be_put_back(light_lids: HandCell) -> None:
    result = pick(light_lids, along=False, spare=0)
    assert result.double_check is not None
    assert (result.double_check.image, result.t_sense) == (None, T_SENSE)


def test_without_the_image_the_weight_decides(light_lids: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = PickerSettings(doubles=DoubleSettings(image=False))
    monkeypatch.setattr(light_lids, "picker", ScriptedPicker(light_lids.env, settings))
    result = pick(light_lids, along=True)
    assert result.double_check is not None
    assert (result.double_check.image, result.double_check.gone, result.t_sense) == (None, None, T_SENSE)
