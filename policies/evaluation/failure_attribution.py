"""Which stage a failed attempt is to blame on: the first that went wrong on the way from the points to the tray."""

from enum import StrEnum

from policies.evaluation.frame_record import CandidateRecord
from policies.grasping.outcomes import GraspOutcome


class Blame(StrEnum):
    """The stage that an attempt failed by. What was not attempted at all is counted by its abstention's reason."""

    SEGMENT = "segment"  # the group that the pose was found in is no part's: IoU under 0.5, or mostly on no part
    POSE = "pose"  # of a good segment, but not right for its part
    GRASP = "grasp"  # on a right pose the jaw closed in vain, or let the part slip
    PHYSICS = "physics"  # on a right pose anything else: a collision, a second part, a bad drop


_BY_THE_JAW = frozenset({GraspOutcome.MISSED, GraspOutcome.SLIPPED})


def blame(outcome: GraspOutcome, candidate: CandidateRecord) -> Blame | None:
    """Return what an attempt failed by, None for a delivery.

    Args:
        outcome: How it ended.
        candidate: That it was made on. Where nothing was segmented the segment is never to blame.
    """
    if outcome is GraspOutcome.DELIVERED:
        return None
    if not candidate.well_segmented:
        return Blame.SEGMENT
    if not candidate.right:
        return Blame.POSE
    return Blame.GRASP if outcome in _BY_THE_JAW else Blame.PHYSICS
