"""Findings made by hand for tests: a part about which nothing is to be done, and changes of it."""

from dataclasses import replace
from typing import Any

from binpick_env.options import CellOptions
from policies.assessment.findings import Findings
from policies.assessment.grip import GripFacts
from policies.assessment.part import PartFacts
from policies.assessment.perception import PerceptionFacts
from policies.assessment.picking import Losses, PickingFacts
from policies.assessment.resting import RestingPose
from policies.assessment.sight import BinFacts, SightFacts

RATES = ("ap", "ap50", "ap75", "recognition", "recall", "precision")
SEEN = PerceptionFacts(
    scenes=20,
    ap=0.95,
    ap50=0.99,
    ap75=0.96,
    recognition=0.98,
    recall=0.97,
    precision=0.99,
    trials=60,
    parts_to_find=300,
    verified=280,
    intervals=dict.fromkeys(RATES, (0.9, 1.0)),
    weights="general.safetensors",
    training="zero-shot",
    clutter={"median": 0.7, "below_half": 0.3, "above_nine_tenths": 0.3, "parts": 500},
    ms=500.0,
)
PICKED = PickingFacts(
    bins=3,
    parts=75,
    gsr={"oracle": 0.99, "gt_masks": 0.98, "learned": 0.97},
    dr={"oracle": 0.99, "gt_masks": 0.98, "learned": 0.97},
    mpph={"oracle": 800.0, "gt_masks": 790.0, "learned": 780.0},
    losses=Losses(delivered=0.97, segmentation=0.01, pose=0.01, picking=0.01),
    failures={"dropped": 1},
    attempts=75,
    ends={"empty": 3},
    left={},
)
FINE = Findings(
    options=CellOptions(part="clip.stl", unit="mm"),
    part=PartFacts(
        name="clip",
        source="/parts/clip.stl",
        unit="mm",
        unit_origin="given",
        other_units={},
        d_max=0.08,
        size=(0.07, 0.03, 0.02),
        mass=0.06,
        density=2700.0,
        volume=2.2e-5,
        symmetry="none",
        near_symmetry=None,
        bodies=1,
        repairs=(),
        faces=1200,
    ),
    rests=(
        RestingPose(share=0.8, up=(0.0, 0.0, 1.0), height=0.02),
        RestingPose(share=0.2, up=(0, 1.0, 0), height=0.03),
    ),
    grip=GripFacts(
        stroke=0.085,
        largest_width=0.078,
        grasps=500,
        widths=(0.02, 0.03),
        least_width=0.02,
        at_rest=(40, 0),
        graspable_share=0.8,
        reason=None,
        whole_stroke_grasps=None,
    ),
    sight=SightFacts(
        distance=0.9, image=(1280, 960), depth=0.87, d_max_px=220.0, points=1800.0, nearest=0.795, whole_bin=True
    ),
    bin=BinFacts(inner_size=(0.36, 0.26, 0.12), capacity=60, wanted=20, dropped=(20, 30), largest_d_max=0.2),
    perception=SEEN,
    picking=PICKED,
)


def changed(group: str, **fields: Any) -> Findings:
    """Return the findings with other fields in one of their groups."""
    return replace(FINE, **{group: replace(getattr(FINE, group), **fields)})
