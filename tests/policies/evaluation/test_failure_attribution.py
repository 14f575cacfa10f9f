"""Which stage a failed attempt is blamed on."""

import pytest

from policies.evaluation.failure_attribution import Blame, blame
from policies.evaluation.frame_record import CandidateRecord
from policies.grasping.outcomes import GraspOutcome

FAILURES = [outcome for outcome in GraspOutcome if outcome is not GraspOutcome.DELIVERED]


def tried(part: int = 0, right: bool = True, overlap: float | None = 0.9) -> CandidateRecord:
    return CandidateRecord(part=part, score=0.9, right=right, found=part if right else -1, overlap=overlap)


@pytest.mark.parametrize("candidate", [tried(), tried(right=False), tried(part=-1, right=False, overlap=0.0)])
def test_a_delivery_is_nobodys_fault(candidate: CandidateRecord) -> None:
    assert blame(GraspOutcome.DELIVERED, candidate) is None


@pytest.mark.parametrize("outcome", FAILURES)
@pytest.mark.parametrize(
    "candidate",
    [
        tried(overlap=0.49),  # even where the pose came out right
        tried(overlap=0.49, right=False),
        tried(part=-1, right=False, overlap=0.0),  # most of its points lie on no part
    ],
)
def test_a_bad_segment_is_blamed_first(outcome: GraspOutcome, candidate: CandidateRecord) -> None:
    assert blame(outcome, candidate) is Blame.SEGMENT


@pytest.mark.parametrize("outcome", FAILURES)
@pytest.mark.parametrize("overlap", [0.5, None])
def test_a_wrong_pose_of_a_good_segment_is_blamed_next(outcome: GraspOutcome, overlap: float | None) -> None:
    assert blame(outcome, tried(right=False, overlap=overlap)) is Blame.POSE


@pytest.mark.parametrize("outcome", [GraspOutcome.MISSED, GraspOutcome.SLIPPED])
def test_on_a_right_pose_the_grasp_is_blamed_for_an_empty_jaw(outcome: GraspOutcome) -> None:
    assert blame(outcome, tried()) is Blame.GRASP


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
def test_on_a_right_pose_all_else_is_physics(outcome: GraspOutcome) -> None:
    assert blame(outcome, tried()) is Blame.PHYSICS


@pytest.mark.parametrize("outcome", FAILURES)
@pytest.mark.parametrize("right", [True, False])
def test_where_the_truth_was_read_no_segment_is_blamed(outcome: GraspOutcome, right: bool) -> None:
    for part in (0, -1):
        assert blame(outcome, tried(part=part, right=right, overlap=None)) is not Blame.SEGMENT


def test_the_names_in_the_results_file_are_a_contract() -> None:
    assert [str(each) for each in Blame] == ["segment", "pose", "grasp", "physics"]
