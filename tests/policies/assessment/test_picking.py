"""Where parts are lost, from records worked by hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from policies.assessment.picking import Losses, picking_facts
from policies.evaluation.budget import make_budget
from policies.evaluation.summary import summarise
from policies.evaluation.undelivered import LeftReason, UndeliveredPart
from tests.policies.evaluation.test_budget import made, runs


def test_losses_are_the_differences_of_the_three_runs_and_add_up_to_all_parts(tmp_path: Path) -> None:
    records = made(tmp_path)  # 4, 3 and 1 of 20 parts are delivered
    place = (0.0, 0.0, 0.0)
    left = [
        UndeliveredPart(part=k, position=place, visible_fraction=1.0, reason=reason)
        for k, reason in enumerate([LeftReason.NO_CLEAR_APPROACH, LeftReason.NO_CLEAR_APPROACH, LeftReason.NOT_TRIED])
    ]
    records["oracle"][0] = replace(records["oracle"][0], undelivered=tuple(left))
    modes = {mode: summarise(records[mode], run[0], np.random.default_rng(0)) for mode, run in runs(tmp_path).items()}
    facts = picking_facts(make_budget(records, modes, np.random.default_rng(0)), records)
    losses = facts.losses
    shares = (losses.delivered, losses.segmentation, losses.pose, losses.picking)
    assert shares == pytest.approx((0.05, 0.1, 0.05, 0.8))
    assert sum(shares) == pytest.approx(1.0)
    assert losses.largest() == "picking"
    assert (facts.parts, facts.bins, facts.failed, facts.attempts) == (20, 2, 0, 4)
    assert (facts.failures, facts.ends) == ({}, {"abstained": 2})
    assert facts.left == {"no_clear_approach": 2, "not_tried": 1}
    assert facts.gsr == {"oracle": 1.0, "gt_masks": 0.75, "learned": 0.25}


def test_where_nothing_is_lost_no_stage_is_named() -> None:
    assert Losses(delivered=1.0, segmentation=0.0, pose=0.0, picking=0.0).largest() == ""
    assert Losses(delivered=1.02, segmentation=-0.03, pose=0.01, picking=0.0).largest() == "pose"
