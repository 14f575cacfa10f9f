"""Hindsight: candidates are attempted from one state, one attempt is kept, nothing is left of the others."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from binpick_env.env import BinPickEnv
from policies.evaluation.records import BinRecord
from policies.grasping.outcomes import Abstention, GraspOutcome, PickResult
from policies.picking.plan import Plan
from policies.selection.candidate_generator import CandidateGenerator
from policies.selection.hindsight import TRIED, HindsightPicker, HindsightTally, hindsight_tally
from policies.selection.selectors import SelectorPicker, WeightedSelector
from tests.policies.fake_cell import attempt, bin_result
from tests.policies.hand_cell import Blind, HandCell, Shifted, decision, hand_cell, lie

pytestmark = pytest.mark.slow

AIR = (0.0, 0.0, 0.1)  # said to hover, so that the jaw closes on nothing


def lay_two(cell: HandCell, monkeypatch: pytest.MonkeyPatch, *, liars: int = 1) -> None:
    """Lay two parts; of the one that the scripted picker prefers, or of both, the pose is wrong."""
    poses = cell.flat(0.08, 0.0), cell.flat(-0.08, 0.02, yaw=0.5)
    cell.lay(*poses)
    preferred = cell.env.candidates[cell.picker.grasps()[0].candidate].part
    lie(monkeypatch, cell, Shifted(AIR, parts=None if liars == 2 else (preferred,)))
    cell.lay(*poses)


def state(cell: HandCell) -> tuple[Any, ...]:
    """Return all that an attempt changes: the physics, the next frame, what is random then, what failed."""
    env = cell.env
    failed = [(f.centre_world.tobytes(), f.T_world_grasp.tobytes()) for f in cell.picker.failed._failures]
    physics = env.simulation.data
    seen = env.frame.depth.tobytes(), env.frame.grey.tobytes(), env.frame_id, env.np_random.bit_generator.state
    counts = env.delivered, env.remaining, tuple(env.events), env.episode.steps, env.simulation.time
    return physics.qpos.tobytes(), physics.qvel.tobytes(), seen, counts, failed


def by_hand(cell: HandCell, row: int) -> PickResult:
    """Attempt the candidate in ``row``."""
    plan = cell.picker.plan(CandidateGenerator(cell.env, cell.picker, 1).generate().grasps[row])
    assert isinstance(plan, Plan)
    return cell.picker.execute(plan)


def tried(result: PickResult) -> float:
    assert result.grasp is not None
    return result.grasp.features[TRIED]


def test_an_attempt_from_a_snapshot_is_the_same_attempt(tees: HandCell) -> None:
    """Also in another cell."""
    tees.lay(tees.flat(0.05, 0.0), tees.flat(-0.06, 0.03, yaw=0.7))
    snapshot = tees.env.snapshot()
    result, after = tees.picker.pick(), state(tees)
    assert result.success
    tees.env.restore(snapshot)
    tees.picker.reset()
    assert decision(tees.picker.pick()) == decision(result)
    assert state(tees) == after
    other = hand_cell("tee", 6)
    other.env.restore(snapshot)
    assert decision(other.picker.pick()) == decision(result)
    assert state(other) == after
    other.env.close()


def test_the_first_row_that_delivers_is_kept_and_the_failure_before_it_undone(
    tees: HandCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    lay_two(tees, monkeypatch)
    expected = by_hand(tees, 1)
    after = state(tees)
    lay_two(tees, monkeypatch)
    result = HindsightPicker(tees.env, tees.picker, per_part=1).pick()
    assert (result.outcome, tried(result)) == (GraspOutcome.DELIVERED, 2)
    assert decision(result) == decision(expected)
    assert state(tees) == after
    assert not tees.picker.failed._failures


def test_without_a_delivery_the_first_failure_is_kept(tees: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    lay_two(tees, monkeypatch, liars=2)
    expected = by_hand(tees, 0)
    after = state(tees)
    lay_two(tees, monkeypatch, liars=2)
    result = HindsightPicker(tees.env, tees.picker, per_part=1).pick()
    assert (result.outcome, tried(result)) == (GraspOutcome.MISSED, 2)
    assert decision(result) == decision(expected)
    assert state(tees) == after
    assert len(tees.picker.failed._failures) == 1


def test_tries_have_a_limit(tees: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    lay_two(tees, monkeypatch)
    result = HindsightPicker(tees.env, tees.picker, per_part=1, most=1).pick()
    assert (result.outcome, tried(result)) == (GraspOutcome.MISSED, 1)
    with pytest.raises(ValueError, match="most must be at least 1, got 0"):
        HindsightPicker(tees.env, tees.picker, most=0)


def test_a_delivering_first_row_is_what_the_weighted_selector_takes(tees: HandCell) -> None:
    makers: list[Callable[[BinPickEnv], Any]] = [
        lambda env: HindsightPicker(env, tees.picker),
        lambda env: SelectorPicker(env, WeightedSelector(), tees.picker),
    ]
    seen = []
    for make in makers:
        tees.lay(tees.flat(0.08, 0.0), tees.flat(-0.08, 0.02))
        result = make(tees.env).pick()
        seen.append((decision(result), state(tees)))
        assert result.t_compute > 0
    assert seen[0] == seen[1]


def test_rows_without_a_way_are_no_attempts(tees: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    tees.lay(tees.flat(0.08, 0.0), tees.flat(-0.08, 0.02))
    picker = HindsightPicker(tees.env, tees.picker, per_part=1, most=1)
    second, real = CandidateGenerator(tees.env, tees.picker, 1).generate().grasps[1], tees.picker.plan
    with monkeypatch.context() as patch:
        patch.setattr(tees.picker, "plan", lambda grasp: Abstention.NO_CLEAR_APPROACH)
        blocked = picker.pick()
    assert (blocked.abstention, blocked.frame_id) == (Abstention.NO_CLEAR_APPROACH, tees.env.frame_id)
    assert tees.log == []

    def only_second(grasp: Any) -> Any:
        same = np.array_equal(grasp.T_world_tcp, second.T_world_tcp)
        return real(grasp) if same else Abstention.NO_CLEAR_APPROACH

    monkeypatch.setattr(tees.picker, "plan", only_second)
    result = picker.pick()
    assert (result.outcome, tried(result)) == (GraspOutcome.DELIVERED, 1)


def test_no_candidate_is_an_abstention(tees: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    lie(monkeypatch, tees, Blind())
    tees.lay(tees.flat())
    result = HindsightPicker(tees.env, tees.picker).pick()
    assert (result.abstention, result.t_sense) == (Abstention.NO_CANDIDATE, 0.5)
    assert tees.log == []


def test_decisions_are_counted_by_what_hindsight_gained() -> None:
    def kept(outcome: GraspOutcome, tries: int) -> PickResult:
        plain = attempt(outcome)
        assert plain.grasp is not None
        return replace(plain, grasp=replace(plain.grasp, features={TRIED: float(tries)}))

    D, M = GraspOutcome.DELIVERED, GraspOutcome.MISSED

    def record(*picks: PickResult) -> BinRecord:
        times = {"wall": 1.0, "settle": 0.1, "render": 0.1}
        return BinRecord.from_result(bin_result(*picks), [""] * len(picks), config_hash="", index=0, **times)

    picks = [kept(D, 1), kept(D, 4), kept(D, 1), kept(M, 7), kept(M, 1), kept(D, 2)]
    silent = PickResult(abstention=Abstention.NO_CANDIDATE)
    records = [record(*picks[:3]), record(*picks[3:], silent)]
    tally = hindsight_tally(records)
    assert tally == HindsightTally(first=2, another=2, none=2, tries=16)
    assert tally.decisions == 6
    assert "of 6 decisions with hindsight, the first attempt delivered in 2, only another in 2, none in 2" in str(tally)
