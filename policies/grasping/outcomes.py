"""Grasps, outcomes of attempts, and results of decisions."""

from dataclasses import dataclass, field
from enum import StrEnum

from perception.geometry import Floats


class GraspOutcome(StrEnum):
    """How an executed attempt ended, judged by the simulation.

    An attempt begins when the gripper leaves the pre-grasp.
    """

    DELIVERED = "delivered"  # one part, released, at rest in the tray alone; parts lost on the way are counted apart
    COLLIDED = "collided"  # exceeded the contact force on the approach, which was broken off
    MISSED = "missed"  # the jaw closed and held nothing
    SLIPPED = "slipped"  # held at first, lost during the lift
    DROPPED = "dropped"  # lost on the way to the tray
    DOUBLE = "double"  # more than one part came along
    LEFT_BIN = "left_bin"  # a part came to lie outside of bin and tray
    NOT_SETTLED = "not_settled"  # released, but not at rest in the tray in time
    PUT_BACK = "put_back"  # the picker found more than one part in its jaw and put them back into the bin


class Abstention(StrEnum):
    """Why no attempt was made."""

    NO_CANDIDATE = "no_candidate"  # perception found no part
    # every grasp would touch a neighbour or a wall, failed before, or is on a part that seems to lie under others
    NO_CLEAR_APPROACH = "no_clear_approach"
    IK_INFEASIBLE = "ik_infeasible"  # clear grasps exist, but the arm reaches none of them


class PushOutcome(StrEnum):
    """How a push ended: a motion of the closed fingertips that moves a part instead of picking it."""

    FREED = "freed"  # a grasp can be planned in the frame after the push
    MOVED = "moved"  # the fingertips pressed and dragged, but there is no grasp yet
    BROKEN_OFF = "broken_off"  # the contact force exceeded its limit on the way
    NOT_TOUCHED = "not_touched"  # the fingertips met nothing where the part was expected
    LEFT_BIN = "left_bin"  # a part came to lie outside of the bin


@dataclass(frozen=True, eq=False, kw_only=True)
class Grasp:
    """A parallel-jaw grasp on a part.

    The grasp frame: origin midway between the two fingertips' ends when the pads touch the part, z along the approach,
    y along the closing direction, x across the pads.

    Attributes:
        T_part_grasp: (4, 4) grasp frame in the part frame.
        width: Distance between the pads at contact [m].
        quality: Quality of the grasp on the lone part in [0, 1], higher is better.
    """

    T_part_grasp: Floats
    width: float
    quality: float


@dataclass(frozen=True, eq=False, kw_only=True)
class GraspCandidate:
    """A grasp on an observed part that is clear of the observed scene.

    Attributes:
        T_world_grasp: (4, 4) grasp frame at contact.
        T_world_tcp: (4, 4) pose of the arm's tcp at which the pads close on the part.
        width: Distance between the pads at contact [m].
        opening: Distance between the pads during the approach [m].
        candidate: Row of the pose candidate in the observation.
        score: Score among all grasps of the frame; higher is tried first.
        features: Named scalars that the score is made of.
    """

    T_world_grasp: Floats
    T_world_tcp: Floats
    width: float
    opening: float
    candidate: int
    score: float
    features: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class DoubleCheck:
    """What was measured of the load after the lift, to tell one part from more.

    Attributes:
        jaw_excess: Distance between the pads beyond that of the grasp [m].
        load: Weight that the wrist feels over the weight of one part.
        jaw: Whether the jaw says that there is more than one part.
        weight: Whether the weight says so.
        held: True number of parts that came along (for reports; a policy never reads it).
        gone: Area that is gone from the bin beside or on the picked part, as a share of the part's mean silhouette;
            None where no image was taken of the bin.
        image: Whether the image says that there is more than one part; None where none was taken.
    """

    jaw_excess: float
    load: float
    jaw: bool
    weight: bool
    held: int
    gone: float | None = None
    image: bool | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class PickResult:
    """One decision of a picker: an executed attempt, an abstention, or a push. One of the first three is not None.

    Attributes:
        outcome: How the attempt ended.
        abstention: Why no attempt was made.
        push: How the push ended.
        grasp: Grasp that was attempted; None unless an attempt was made.
        part: True index of the target part, -1 if unknown (for reports; a policy never reads it).
        delivered: Number of parts delivered by the attempt (0 or 1).
        t_sense: Nominal exposure time [s].
        t_compute: Wall clock of perception and planning [s].
        t_motion: Simulated time of the motion [s].
        t_concurrent: Part of ``t_sense`` and ``t_compute`` that passed during the motion of the decision before [s].
        frame_id: Number of the frame that the decision was made on.
        double_check: What was measured of the load after the lift; None if nothing was lifted.
    """

    outcome: GraspOutcome | None = None
    abstention: Abstention | None = None
    push: PushOutcome | None = None
    grasp: GraspCandidate | None = None
    part: int = -1
    delivered: int = 0
    t_sense: float = 0.0
    t_compute: float = 0.0
    t_motion: float = 0.0
    t_concurrent: float = 0.0
    frame_id: int = -1
    double_check: DoubleCheck | None = None

    def __post_init__(self) -> None:
        if [self.outcome, self.abstention, self.push].count(None) != 2:
            raise ValueError("a PickResult has either an outcome or an abstention or a push")

    @property
    def ending(self) -> GraspOutcome | Abstention | PushOutcome:
        """How the decision ended, whichever kind it was."""
        ending = self.outcome or self.abstention or self.push
        assert ending is not None
        return ending

    @property
    def success(self) -> bool:
        """Whether exactly one part was delivered."""
        return self.outcome is GraspOutcome.DELIVERED
