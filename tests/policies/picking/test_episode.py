from typing import Any

import pytest

from policies.grasping.outcomes import Abstention, GraspOutcome, PickResult, PushOutcome
from policies.picking.episode import BinResult, Termination, run_bin
from tests.policies.fake_cell import FakeEnv, ScriptPicker, abstain, attempt, pushed

DELIVERED, MISSED, DROPPED = GraspOutcome.DELIVERED, GraspOutcome.MISSED, GraspOutcome.DROPPED


def play(*script: PickResult, env: FakeEnv | None = None, **options: Any) -> tuple[BinResult, FakeEnv, ScriptPicker]:
    env = env or FakeEnv(parts=10)
    picker = ScriptPicker(env, *script)
    return run_bin(env, picker, 5, **options), env, picker  # type: ignore[arg-type]


def test_two_consecutive_failures_end_a_bin() -> None:
    result, _, picker = play(attempt(MISSED), attempt(DELIVERED), attempt(MISSED), attempt(DROPPED), attempt(DELIVERED))
    assert result.termination is Termination.TWO_FAILURES
    assert [pick.outcome for pick in result.picks] == [MISSED, DELIVERED, MISSED, DROPPED]
    assert len(picker.script) == 1


@pytest.mark.parametrize(("max_failures", "attempts"), [(1, 1), (3, 5), (None, 6)])
def test_the_number_of_failures_that_end_a_bin_can_be_set(max_failures: int | None, attempts: int) -> None:
    script = [attempt(o) for o in (MISSED, DELIVERED, MISSED, MISSED, DROPPED, MISSED)]
    result, _, _ = play(*script, abstain(), abstain(), max_failures=max_failures)
    assert len(result.attempts) == attempts
    ended = Termination.ABSTAINED if max_failures is None else Termination.TWO_FAILURES
    assert result.termination is ended


def test_an_abstention_between_two_failures_does_not_part_them() -> None:
    result, env, _ = play(attempt(MISSED), abstain(), attempt(MISSED))
    assert result.termination is Termination.TWO_FAILURES
    assert env.extra_frames == 1


def test_a_new_frame_follows_one_abstention_and_a_second_ends_the_bin() -> None:
    result, env, _ = play(abstain(), attempt(DELIVERED), abstain(Abstention.IK_INFEASIBLE), abstain())
    assert result.termination is Termination.ABSTAINED
    assert env.extra_frames == env.likely_frames == 2  # not after the last
    assert [pick.abstention is not None for pick in result.picks] == [True, False, True, True]
    assert len(result.attempts) == 1


def test_a_push_neither_counts_as_a_failure_nor_parts_two() -> None:
    result, _, _ = play(attempt(MISSED), abstain(), pushed(), attempt(MISSED))
    assert result.termination is Termination.TWO_FAILURES
    assert len(result.attempts) == 2
    result, _, _ = play(attempt(MISSED), pushed(), pushed(), abstain(), abstain())
    assert result.termination is Termination.ABSTAINED


def test_after_a_push_two_abstentions_end_a_bin() -> None:
    result, env, _ = play(abstain(), pushed(), abstain(), pushed(), attempt(DELIVERED), abstain(), abstain())
    assert result.termination is Termination.ABSTAINED
    assert len(result.picks) == 7
    assert env.likely_frames == 3  # after each abstention but the last


def test_an_emptied_bin_ends() -> None:
    result, env, _ = play(*[attempt(DELIVERED)] * 3, env=FakeEnv(parts=3))
    assert result.termination is Termination.EMPTY
    assert (result.delivered, result.parts_total) == (3, 3)
    assert env.extra_frames == 0


def test_emptying_the_bin_by_losing_parts_is_no_two_failures() -> None:
    env = FakeEnv(parts=1, lost=0)
    picker = ScriptPicker(env, attempt(GraspOutcome.LEFT_BIN))
    original = picker.pick

    def lose() -> PickResult:
        env.lost = 1
        return original()

    picker.pick = lose  # type: ignore[method-assign]
    assert run_bin(env, picker, 0).termination is Termination.EMPTY  # type: ignore[arg-type]


def test_truncation_ends_a_bin() -> None:
    result, _, _ = play(env=FakeEnv(parts=2, truncated=True))
    assert result.termination is Termination.TIME
    assert result.picks == ()


def test_the_seed_and_the_callback_arrive() -> None:
    told: list[PickResult] = []
    result, env, _ = play(attempt(MISSED), attempt(MISSED), on_pick=told.append)
    assert env.seeds == [5]
    assert result.seed == 5
    assert tuple(told) == result.picks


def test_clutter_is_that_of_the_settled_bin() -> None:
    result, env, _ = play(abstain(), abstain())
    assert result.clutter.count == env.parts
    assert result.clutter.median == pytest.approx(0.55)


@pytest.mark.parametrize(
    "both",
    [
        {},
        {"outcome": MISSED, "abstention": Abstention.NO_CANDIDATE},
        {"outcome": MISSED, "push": PushOutcome.MOVED},
        {"abstention": Abstention.NO_CANDIDATE, "push": PushOutcome.MOVED},
    ],
)
def test_a_decision_is_either_an_attempt_or_an_abstention(both: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="either an outcome or an abstention"):
        PickResult(**both)
