"""The stage that a failed attempt is attributed to."""

import pytest

from policies.evaluation.failure_attribution import FailureStage, attribute_failure
from policies.evaluation.frame_record import CandidateRecord
from policies.grasping.outcomes import GraspOutcome

FAILURES = [outcome for outcome in GraspOutcome if outcome is not GraspOutcome.DELIVERED]


def compared(part: int = 0, right: bool = True, overlap: float | None = 0.9) -> CandidateRecord:
    return CandidateRecord(part=part, score=0.9, right=right, found=part if right else -1, overlap=overlap)


@pytest.mark.parametrize("candidate", [compared(), compared(right=False), compared(part=-1, right=False, overlap=0.0)])
def test_a_delivery_is_attributed_to_no_stage(candidate: CandidateRecord) -> None:
    assert attribute_failure(GraspOutcome.DELIVERED, candidate) is None


@pytest.mark.parametrize("outcome", FAILURES)
@pytest.mark.parametrize(
    "candidate",
    [
        compared(overlap=0.49),  # even if the pose is correct
        compared(overlap=0.49, right=False),
        compared(part=-1, right=False, overlap=0.0),  # most of its points lie on no part
    ],
)
def test_a_bad_segment_comes_first(outcome: GraspOutcome, candidate: CandidateRecord) -> None:
    assert attribute_failure(outcome, candidate) is FailureStage.SEGMENT


@pytest.mark.parametrize("outcome", FAILURES)
@pytest.mark.parametrize("overlap", [0.5, None])
def test_a_wrong_pose_of_a_good_segment_comes_next(outcome: GraspOutcome, overlap: float | None) -> None:
    assert attribute_failure(outcome, compared(right=False, overlap=overlap)) is FailureStage.POSE


@pytest.mark.parametrize("outcome", [GraspOutcome.MISSED, GraspOutcome.SLIPPED])
def test_with_a_correct_pose_an_empty_jaw_is_attributed_to_the_grasp(outcome: GraspOutcome) -> None:
    assert attribute_failure(outcome, compared()) is FailureStage.GRASP


@pytest.mark.parametrize(
    "outcome",
    [
        GraspOutcome.COLLIDED,
        GraspOutcome.DROPPED,
        GraspOutcome.DOUBLE,
        GraspOutcome.LEFT_BIN,
        GraspOutcome.NOT_SETTLED,
    ],
)
def test_with_a_correct_pose_everything_else_is_attributed_to_physics(outcome: GraspOutcome) -> None:
    assert attribute_failure(outcome, compared()) is FailureStage.PHYSICS


@pytest.mark.parametrize("outcome", FAILURES)
@pytest.mark.parametrize("right", [True, False])
def test_without_segments_no_failure_is_attributed_to_a_segment(outcome: GraspOutcome, right: bool) -> None:
    for part in (0, -1):
        assert attribute_failure(outcome, compared(part=part, right=right, overlap=None)) is not FailureStage.SEGMENT


def test_the_names_in_the_results_file_are_a_contract() -> None:
    assert [str(each) for each in FailureStage] == ["segment", "pose", "grasp", "physics"]
