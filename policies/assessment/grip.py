"""Which grasps a part has, and from which resting poses a jaw picks it off the floor."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from binpick_env.config import GRIPPER_STROKE
from perception.part import PartModel
from policies.assessment.resting import RestingPose
from policies.grasping.clearance import clear_of_floor
from policies.grasping.grasps import GraspSettings, least_width, sample_grasps, why_no_grasp
from policies.grasping.gripper import gripper_model


@dataclass(frozen=True, kw_only=True)
class GripFacts:
    """Which grasps a part has.

    Attributes:
        stroke: Largest opening of the jaw [m].
        largest_width: Largest distance between the pads at contact that the jaw takes [m].
        grasps: Number of grasps on the lone part.
        widths: Smallest and largest distance between the pads at contact [m]; None without a grasp.
        least_width: Distance between the nearest two opposite faces [m]; infinite if there are none.
        at_rest: Number of grasps that pick the part off a floor, for each resting pose.
        graspable_share: Share of drops that end in a resting pose with such a grasp.
        reason: Why the jaw finds no grasp; None if it finds one.
        whole_stroke_grasps: Number of grasps if the jaw opened as wide as the gripper can; None if it does.
    """

    stroke: float
    largest_width: float
    grasps: int
    widths: tuple[float, float] | None
    least_width: float
    at_rest: tuple[int, ...]
    graspable_share: float
    reason: str | None
    whole_stroke_grasps: int | None


def grip_facts(
    model: PartModel, rests: Sequence[RestingPose], jaw: float | None = None, settings: GraspSettings | None = None
) -> GripFacts:
    """Return which grasps a part has; seconds for a new part, see :func:`policies.grasping.grasps.sample_grasps`.

    Args:
        model: Part.
        rests: Resting poses of the part.
        jaw: Largest opening of the jaw [m]; the gripper's own if None.
        settings: How grasps are sampled; the defaults if None.
    """
    settings = settings or GraspSettings()
    limited = settings if jaw is None else settings.limited_to(jaw)
    grasps = sample_grasps(model, settings, jaw=jaw)
    at_rest = tuple(int(clear_of_floor(r.T_floor_part(model), grasps, gripper_model(jaw)).sum()) for r in rests)
    narrowed = jaw is not None and jaw < GRIPPER_STROKE
    return GripFacts(
        stroke=GRIPPER_STROKE if jaw is None else jaw,
        largest_width=limited.max_width,
        grasps=len(grasps),
        widths=(float(np.min(grasps.width)), float(np.max(grasps.width))) if len(grasps) else None,
        least_width=least_width(model, settings),
        at_rest=at_rest,
        graspable_share=float(sum(rest.share for rest, count in zip(rests, at_rest, strict=True) if count)),
        reason=None if len(grasps) else why_no_grasp(model, settings, jaw=jaw),
        whole_stroke_grasps=len(sample_grasps(model, settings)) if narrowed else None,
    )
