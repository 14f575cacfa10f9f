"""A part that lies at a wall without a grasp is pushed and then picked, on the real physics."""

import numpy as np
import pytest

from perception.geometry import Floats
from policies.grasping.outcomes import Abstention, GraspOutcome, PushOutcome
from policies.grasping.pushes import PushSettings
from policies.picking.extra_decisions import ExtraDecisions
from policies.picking.scripted import ScriptedPicker
from policies.picking.settings import PickerSettings
from tests.policies.hand_cell import HandCell

PUSHING = PickerSettings()


@pytest.fixture
def pushing(lids: HandCell, monkeypatch: pytest.MonkeyPatch) -> HandCell:
    """Return the lids' cell with a picker that pushes, and that may do so at once."""
    monkeypatch.setattr(lids, "picker", ScriptedPicker(lids.env, PUSHING))
    monkeypatch.setattr(ExtraDecisions, "allows", lambda *_: True)
    return lids


def at_wall(cell: HandCell) -> Floats:
    return cell.flat(0.1308, 0.0742, yaw=np.radians(-19))


@pytest.mark.slow
def test_a_lid_in_a_corner_has_no_grasp(lids: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lids, "picker", ScriptedPicker(lids.env, PickerSettings().attempts_only()))
    lids.lay(at_wall(lids))
    assert [lids.picker.pick().abstention for _ in range(3)] == [Abstention.NO_CLEAR_APPROACH] * 3


@pytest.mark.slow
def test_a_lid_in_a_corner_is_pushed_free_before_the_picker_gives_up(pushing: HandCell) -> None:
    pushing.lay(at_wall(pushing))
    simulation, workspace = pushing.env.simulation, pushing.env.workspace
    before = simulation.part_centres()[0]
    assert pushing.picker.pick().abstention is Abstention.NO_CLEAR_APPROACH
    frame_id = pushing.env.frame_id
    result = pushing.picker.pick()
    assert (result.push, result.outcome, result.abstention) == (PushOutcome.FREED, None, None)
    assert (result.grasp, result.delivered, result.frame_id) == (None, 0, frame_id)
    assert result.t_motion > 1.0
    assert pushing.at_home
    assert pushing.env.frame_id == frame_id + 1
    after = simulation.part_centres()[0]
    assert np.linalg.norm(after - before) > 0.03
    assert workspace.contains(after[None]).all()
    assert all(step.action[6] > 0.5 for step in pushing.log if step.force > 1.0)  # whatever it touches, it is closed
    assert max(step.force for step in pushing.log) < 3 * PushSettings().stop_force
    assert pushing.picker.pick().outcome is GraspOutcome.DELIVERED


@pytest.mark.slow
def test_a_part_follows_the_fingertips_that_press_on_it(pushing: HandCell) -> None:
    pushing.lay(at_wall(pushing))
    pushing.picker.pick()
    planned = pushing.picker._plan_push()
    assert planned is not None
    _, push, _ = planned
    before = pushing.env.simulation.part_centres()[0]
    pushing.picker._push(*planned)
    moved = pushing.env.simulation.part_centres()[0] - before
    along = float(moved @ push.drag_world) / float(np.linalg.norm(push.drag_world))
    assert along > 0.7 * np.linalg.norm(push.drag_world)
    pressing = [step.force for step in pushing.log if step.force > 1.0]
    assert np.median(pressing) == pytest.approx(PushSettings().drag_force, rel=0.5)


@pytest.mark.slow
def test_a_push_that_meets_a_greater_force_is_broken_off(pushing: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    careful = PickerSettings(push=PushSettings(press_force=5.0, drag_force=4.0, stop_force=6.0))
    monkeypatch.setattr(pushing, "picker", ScriptedPicker(pushing.env, careful))
    pushing.lay(at_wall(pushing))
    pushing.picker.pick()
    assert pushing.picker.pick().push is PushOutcome.BROKEN_OFF
    assert pushing.at_home


@pytest.mark.slow
def test_a_push_of_a_part_that_is_gone_touches_nothing(pushing: HandCell) -> None:
    pushing.lay(at_wall(pushing))
    pushing.picker.pick()
    pushing.env.simulation.place(0, pushing.env.workspace.T_world_bin @ pushing.flat(-0.1, 0.0))
    assert pushing.picker.pick().push in {PushOutcome.NOT_TOUCHED, PushOutcome.FREED}
    assert pushing.at_home


@pytest.mark.slow
def test_a_part_that_only_the_frame_before_shows_is_pushed(pushing: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    pushing.lay(at_wall(pushing))
    assert pushing.picker.pick().abstention is Abstention.NO_CLEAR_APPROACH
    monkeypatch.setattr(type(pushing.env), "candidates", ())
    result = pushing.picker.pick()
    assert (result.push, result.part) == (PushOutcome.MOVED, 0)


def test_a_part_that_was_moved_twice_is_left_alone(pushing: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ExtraDecisions, "allows", lambda *_: False)
    pushing.lay(at_wall(pushing))
    assert [pushing.picker.pick().abstention for _ in range(2)] == [Abstention.NO_CLEAR_APPROACH] * 2
    assert pushing.log == []


def test_the_parts_in_sight_will_take_decisions_of_which_a_share_may_be_pushes(
    pushing: HandCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def refuse(_: ExtraDecisions, __: Floats, expected: int = 0) -> bool:
        asked.append(expected)
        return False

    monkeypatch.setattr(ExtraDecisions, "allows", refuse)
    pushing.lay(at_wall(pushing), pushing.flat(-0.09))
    assert pushing.picker._plan_push() is None
    assert set(asked) == {1}
