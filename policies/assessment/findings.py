"""Everything that was measured of a part in a cell, which advice is drawn from."""

from dataclasses import dataclass

from binpick_env.options import CellOptions
from policies.assessment.grip import GripFacts
from policies.assessment.part import PartFacts
from policies.assessment.perception import PerceptionFacts
from policies.assessment.picking import PickingFacts
from policies.assessment.resting import RestingPose
from policies.assessment.sight import BinFacts, SightFacts


@dataclass(frozen=True, kw_only=True)
class Findings:
    """Everything that was measured.

    Attributes:
        options: Part and cell.
        part: What the part is.
        rests: How the part rests on a floor, the most frequent pose first.
        grip: Which grasps the part has.
        sight: How the camera sees the part.
        bin: How many parts the bin holds.
        perception: How well segmentation and pose estimation work; None if it was not run.
        picking: Where parts are lost; None if no bin was picked.
        not_perceived: Why perception was not run; None if it was.
        not_picked: Why no bin was picked; None if bins were.
    """

    options: CellOptions
    part: PartFacts
    rests: tuple[RestingPose, ...]
    grip: GripFacts
    sight: SightFacts
    bin: BinFacts
    perception: PerceptionFacts | None = None
    picking: PickingFacts | None = None
    not_perceived: str | None = None
    not_picked: str | None = None
