"""The values that picking ends in."""

from dataclasses import FrozenInstanceError
from typing import Any

import pytest

from policies.grasping.outcomes import Abstention, GraspOutcome, PickResult, PushOutcome
from tests.policies.fake_cell import attempt, grasp


@pytest.mark.parametrize("outcome", GraspOutcome)
def test_only_a_delivery_is_a_success(outcome: GraspOutcome) -> None:
    assert PickResult(outcome=outcome).success == (outcome is GraspOutcome.DELIVERED)


@pytest.mark.parametrize("reason", Abstention)
def test_an_abstention_is_no_success_and_moves_nothing(reason: Abstention) -> None:
    result = PickResult(abstention=reason)
    assert not result.success
    assert (result.outcome, result.grasp, result.delivered, result.t_motion) == (None, None, 0, 0.0)


def test_what_is_not_known_says_so() -> None:
    result = PickResult(outcome=GraspOutcome.MISSED)
    assert (result.part, result.frame_id) == (-1, -1)


@pytest.mark.parametrize("both", [{}, {"outcome": GraspOutcome.MISSED, "abstention": Abstention.IK_INFEASIBLE}])
def test_a_result_is_one_of_the_three(both: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"^a PickResult has either an outcome or an abstention or a push$"):
        PickResult(**both)


def test_the_names_in_the_results_file_are_a_contract() -> None:
    assert [str(outcome) for outcome in GraspOutcome] == [
        "delivered",
        "collided",
        "missed",
        "slipped",
        "dropped",
        "double",
        "left_bin",
        "not_settled",
        "put_back",
    ]
    assert [str(ending) for ending in PushOutcome] == ["freed", "moved", "broken_off", "not_touched", "left_bin"]
    assert [str(reason) for reason in Abstention] == ["no_candidate", "no_clear_approach", "ik_infeasible"]


def test_results_are_frozen_and_two_attempts_are_never_the_same() -> None:
    result = attempt(GraspOutcome.DELIVERED)
    with pytest.raises(FrozenInstanceError):
        result.delivered = 2  # type: ignore[misc]
    assert result != attempt(GraspOutcome.DELIVERED)  # they hold arrays: identity it is
    assert len({result, attempt(GraspOutcome.DELIVERED)}) == 2


def test_features_are_not_shared_between_grasps() -> None:
    assert grasp().features is not grasp().features
