"""Failure attribution: the first stage that went wrong in a failed attempt, from segmentation to physics."""

from enum import StrEnum

from policies.evaluation.frame_record import CandidateRecord
from policies.grasping.outcomes import GraspOutcome


class FailureStage(StrEnum):
    """The stage at which an attempt failed. Abstentions are no failures; they are counted by their reasons."""

    SEGMENT = "segment"  # the segment behind the pose has an IoU under 0.5 with its part, or lies mostly on no part
    POSE = "pose"  # the segment is good, but the pose is wrong
    GRASP = "grasp"  # the pose is correct, but the jaw closed on nothing or the part slipped
    PHYSICS = "physics"  # the pose is correct, and anything else went wrong: a collision, a second part, a bad drop


_GRASP_OUTCOMES = frozenset({GraspOutcome.MISSED, GraspOutcome.SLIPPED})


def attribute_failure(outcome: GraspOutcome, candidate: CandidateRecord) -> FailureStage | None:
    """Return the stage at which an attempt failed, None for a delivery.

    Args:
        outcome: How the attempt ended.
        candidate: The candidate that was grasped, compared with the ground truth. Where nothing was segmented, no
            failure is attributed to the segment.
    """
    if outcome is GraspOutcome.DELIVERED:
        return None
    if not candidate.well_segmented:
        return FailureStage.SEGMENT
    if not candidate.right:
        return FailureStage.POSE
    return FailureStage.GRASP if outcome in _GRASP_OUTCOMES else FailureStage.PHYSICS
