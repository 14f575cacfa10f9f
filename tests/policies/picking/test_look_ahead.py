"""The frame that is taken while the load is carried away, and the time that it saves."""

from dataclasses import replace

import numpy as np
import pytest

from binpick_env.cell.robot import HOME
from binpick_env.env import MAX_EPISODE_STEPS, BinPickEnv
from perception.geometry import make_transform
from policies.grasping.outcomes import GraspOutcome, PickResult
from policies.picking import frame_ahead
from policies.picking.bin_view import BinView
from policies.picking.execution import Execution, ExecutionSettings
from policies.picking.load_check import LoadCheck
from policies.picking.scripted import T_SENSE, ScriptedPicker
from policies.picking.settings import PickerSettings
from tests.policies.hand_cell import SMALL_IMAGE, Blind, HandCell, lie

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def env() -> BinPickEnv:
    return BinPickEnv("tee", num_parts=(1, 2), perception="oracle", threads=1, camera=SMALL_IMAGE)


def two_picks(env: BinPickEnv, settings: PickerSettings | None = None) -> tuple[HandCell, list[PickResult], float]:
    """Pick two parts that lie apart; return the cell, the results, and the age of the frame between them [s]."""
    cell = HandCell(env, ScriptedPicker(env, settings))
    cell.lay(cell.flat(0.05), cell.flat(-0.08, yaw=0.6))
    results = [cell.picker.pick()]
    age = env.simulation.time - env.episode.frame.time
    return cell, [*results, cell.picker.pick()], age


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> list[tuple[bool, bool, bool]]:
    """Return for each frame that is taken ahead whether a part is held, whether the arm is away, and is out of view."""
    seen = []
    real = BinPickEnv.look

    def look(env: BinPickEnv, **options: bool) -> object:
        simulation = env.simulation
        if options.get("ahead"):
            away = float(np.abs(simulation.joint_positions - HOME).max()) > 0.25
            seen.append((bool(simulation.gripped()), away, BinView(env).clear()))
        return real(env, **options)

    monkeypatch.setattr(BinPickEnv, "look", look)
    return seen


def test_the_next_frame_is_taken_during_the_carry(env: BinPickEnv, looks: list[tuple[bool, bool, bool]]) -> None:
    _, (first, second), age = two_picks(env)
    assert first.outcome is second.outcome is GraspOutcome.DELIVERED
    assert second.frame_id == first.frame_id + 1  # no other frame is taken at home
    assert looks[0] == (True, True, True)
    assert 1.15 < age < first.t_motion


def test_where_the_arm_is_never_out_of_sight_frames_are_taken_at_home(
    env: BinPickEnv, looks: list[tuple[bool, bool, bool]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_ahead.BinView, "clear", lambda _: False)
    _, (first, second), age = two_picks(env)
    assert (second.frame_id, looks) == (first.frame_id + 1, [])
    assert age < 0.3  # the wait for the judgement, at home


def test_parts_whose_motion_no_image_shows_have_frames_taken_at_home(
    env: BinPickEnv, looks: list[tuple[bool, bool, bool]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_ahead, "shows_motion", lambda _: False)
    _, (first, second), _ = two_picks(env)
    assert (second.frame_id, looks) == (first.frame_id + 1, [])


@pytest.mark.parametrize("changed", [False, True])
def test_an_arm_that_is_stopped_on_its_way_home_goes_there_before_the_next_decision(
    env: BinPickEnv, monkeypatch: pytest.MonkeyPatch, changed: bool
) -> None:
    picker, held = ScriptedPicker(env), []
    go_home = picker._go_home

    def stopped_once(execution: Execution) -> float:
        held.append(True)
        return 0.0 if len(held) == 1 else go_home(execution)

    monkeypatch.setattr(picker, "_go_home", stopped_once)
    monkeypatch.setattr(frame_ahead, "bin_changed", lambda *_: changed)
    cell = HandCell(env, picker)
    cell.lay(cell.flat(0.05), cell.flat(-0.08, yaw=0.6))
    first = picker.pick()
    # Taken ahead, and not again where the arm stands now.
    assert (env.frame_id, cell.at_home) == (first.frame_id + 1, False)
    began = env.simulation.time
    second = picker.pick()
    assert second.frame_id == first.frame_id + 2
    assert second.outcome is GraspOutcome.DELIVERED
    assert cell.at_home
    assert second.t_motion == pytest.approx(env.simulation.time - began)  # the way home counts


def test_no_frame_is_taken_during_the_carry_where_an_image_has_to_tell_a_double(
    env: BinPickEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    monkeypatch.setattr(LoadCheck, "needs_image", property(lambda _: True))
    monkeypatch.setattr(frame_ahead.BinView, "clear", lambda _: asked.append(True))
    two_picks(env)
    assert len(asked) == 2  # over the tray, and not in every step


def test_what_is_computed_while_the_arm_moves_is_told(env: BinPickEnv) -> None:
    _, (first, second), age = two_picks(env)
    assert first.t_concurrent == 0.0
    assert T_SENSE < second.t_concurrent <= min(age, second.t_sense + second.t_compute)


def test_a_frame_that_was_decided_on_before_saves_no_time(env: BinPickEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = HandCell(env, ScriptedPicker(env))
    cell.lay(cell.flat())
    lie(monkeypatch, cell, Blind())
    env.look()
    env.skip(50)
    assert [cell.picker.pick().t_concurrent > 0 for _ in range(2)] == [True, False]


def test_without_looking_ahead_frames_are_taken_at_home(env: BinPickEnv) -> None:
    settings = replace(PickerSettings(), execution=ExecutionSettings(look_ahead=False))
    _, (first, second), age = two_picks(env, settings)
    assert first.outcome is second.outcome is GraspOutcome.DELIVERED
    assert second.frame_id == first.frame_id + 1
    assert second.t_concurrent == pytest.approx(age, abs=1e-9)
    assert age < 0.3  # the wait for the judgement, at home


def test_a_frame_of_a_bin_that_has_changed_is_taken_again_at_home(
    env: BinPickEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_ahead, "bin_changed", lambda *_: True)
    _, (first, second), age = two_picks(env)
    assert (second.frame_id, age, second.t_concurrent) == (first.frame_id + 2, 0.0, 0.0)


def test_a_frame_is_taken_again_after_a_load_was_lost_on_the_way(
    env: BinPickEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = HandCell(env, ScriptedPicker(env))
    cell.lay(cell.flat(0.05), cell.flat(-0.08, yaw=0.6))
    real = BinPickEnv.look

    def look(env: BinPickEnv, **options: bool) -> object:
        seen = real(env, **options)
        if options.get("ahead"):  # the part slips out of the jaw and lies on the table
            held = int(np.argmax(env.simulation.part_centres()[:, 2] * env.simulation.in_play))
            env.simulation.move(held, make_transform(translation=(-0.5, 0.0, 0.05)))
        return seen

    monkeypatch.setattr(BinPickEnv, "look", look)
    first = cell.picker.pick()
    assert first.outcome is not GraspOutcome.DELIVERED
    assert (env.frame_id, env.episode.frame.time) == (first.frame_id + 2, env.simulation.time)


def test_a_carry_that_ends_at_home_leads_to_one_frame(env: BinPickEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    picker = ScriptedPicker(env)
    monkeypatch.setattr(picker._planner, "_release_posture", lambda _: HOME)
    cell = HandCell(env, picker)
    cell.lay(cell.flat(0.05), cell.flat(-0.08, yaw=0.6))
    first, second = picker.pick(), picker.pick()
    assert first.outcome is second.outcome is GraspOutcome.DELIVERED
    assert (second.frame_id, env.frame_id) == (first.frame_id + 1, first.frame_id + 2)


def test_no_frame_is_taken_when_the_episode_is_over(env: BinPickEnv) -> None:
    env.reset(seed=0)
    env.skip(MAX_EPISODE_STEPS)
    Execution(env, ExecutionSettings()).look_ahead()
    assert env.frame_id == 0


def test_a_frame_is_taken_again_after_an_arm_that_went_back_through_the_bin(
    env: BinPickEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    picker = ScriptedPicker(env)
    monkeypatch.setattr(picker._planner, "home", lambda _: None)
    cell = HandCell(env, picker)
    cell.lay(cell.flat(0.05), cell.flat(-0.08, yaw=0.6))
    first = picker.pick()
    assert first.outcome is GraspOutcome.DELIVERED
    assert (env.frame_id, env.episode.frame.time) == (first.frame_id + 2, env.simulation.time)
    assert cell.at_home


def test_policies_that_learn_from_attempts_take_frames_after_them() -> None:
    assert not PickerSettings().attempts_only().execution.look_ahead
