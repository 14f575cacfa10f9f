"""A grasp that the arm can make."""

from dataclasses import dataclass

from perception.geometry import Floats
from policies.grasping.outcomes import GraspCandidate
from policies.motion.trajectory import Trajectory


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan:
    """A grasp with the motion towards it.

    Attributes:
        grasp: Grasp on a candidate of the frame that was planned on.
        q_grasp: (6,) posture in which the pads close [rad].
        approach: Motion from the arm's position to that posture.
        frame_id: Number of the frame that was planned on.
    """

    grasp: GraspCandidate
    q_grasp: Floats
    approach: Trajectory
    frame_id: int
