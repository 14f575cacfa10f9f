"""Parts that were lost or left: where they lay, and why."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from binpick_env.cell.delivery import Delivery, DeliveryEvent
from binpick_env.observation.observed_candidates import ObservedCandidates
from perception.geometry import make_transform
from policies.evaluation.frame_record import record_frame
from policies.evaluation.records import BinRecord, load_record, save_record
from policies.evaluation.undelivered import LeftReason, LossWatch, UndeliveredPart, left_parts
from policies.grasping.outcomes import Abstention, GraspCandidate
from policies.picking.plan import Plan
from policies.picking.scripted import ScriptedPicker
from tests.policies.fake_cell import ScriptPicker, bin_result, candidate, grasp, labelled_capture

LEFT = UndeliveredPart(part=1, position=(0.1, 0.0, 0.02), visible_fraction=0.5, reason=LeftReason.NOT_TRIED)
LOST = UndeliveredPart(part=2, position=(0.0, 0.1, 0.0), visible_fraction=1.0, lost=Delivery.DOUBLE, decision=3)


class VerdictPicker(ScriptedPicker):
    """Finds grasps on candidates 0 to 2, and plans none, an unreachable one and a motion, in this order."""

    def __init__(self) -> None:
        self.settings: Any = SimpleNamespace(grasps_tried=2)

    def grasps(self) -> list[GraspCandidate]:
        made = [grasp() for _ in range(3)]
        for k, each in enumerate(made):
            object.__setattr__(each, "candidate", k)
        return made

    def plan(self, grasp: GraspCandidate) -> Plan | Abstention:
        if grasp.candidate == 2:
            return Plan(grasp=grasp, q_grasp=np.zeros(6), approach=SimpleNamespace(), frame_id=0)  # type: ignore[arg-type]
        return (Abstention.NO_CLEAR_APPROACH, Abstention.IK_INFEASIBLE)[grasp.candidate]


def left(picker: Any) -> list[UndeliveredPart]:
    """Return what is left of six parts: one delivered, one without a candidate, four with one each, the last wrong."""
    view = labelled_capture(np.linspace(0.5, 1.0, 6))
    wrong = make_transform(translation=(0.02, 0.0, 0.0))
    candidates = [candidate(view, k) for k in (1, 2, 3)] + [candidate(view, 4, wrong)]
    found = ObservedCandidates(candidates=candidates)
    in_play = np.array([False, True, True, True, True, True])
    env: Any = SimpleNamespace(labelled_capture=view, simulation=SimpleNamespace(in_play=in_play))
    return left_parts(env, picker, record_frame(0, view, found))


def test_the_reason_is_what_the_picker_makes_of_the_parts_candidates() -> None:
    parts = left(VerdictPicker())
    assert [(part.part, str(part.reason), part.pose_correct) for part in parts] == [
        (1, "no_clear_approach", True),
        (2, "ik_infeasible", True),
        (3, "not_tried", True),
        (4, "no_clear_approach", False),
        (5, "no_candidate", None),
    ]
    # The bin is at x = 0.5 m in the world; part k has its centre at 0.5 + 0.07 k.
    assert parts[0].position == pytest.approx((0.07, 0.0, 0.0), abs=1e-5)
    assert parts[0].visible_fraction == pytest.approx(0.6)


def test_another_picker_tells_no_reason() -> None:
    env: Any = None
    assert {part.reason for part in left(ScriptPicker(env))} == {None}


def test_a_lost_part_is_noted_where_it_last_lay_inside_the_bin() -> None:
    watch, view = LossWatch(), labelled_capture(np.array([1.0, 0.5, 1.0, 1.0]))  # the last lies beyond the wall
    watch.before(view)
    delivered = DeliveryEvent(part=0, kind=Delivery.DELIVERED, time=1.0)
    watch.after([delivered], 0)
    moved = labelled_capture(np.array([0.0, 0.9, 1.0, 1.0]))
    moved.T_world_parts[1, 0, 3] = 2.0
    watch.before(moved)
    lost = [DeliveryEvent(part=k, kind=kind, time=2.0) for k, kind in ((1, Delivery.LEFT_BIN), (2, Delivery.DOUBLE))]
    watch.after([delivered, *lost], 1)
    assert [(part.part, part.lost, part.decision) for part in watch.lost] == [(1, "left_bin", 1), (2, "double", 1)]
    assert watch.lost[0].position == pytest.approx((0.07, 0.0, 0.0), abs=1e-5)
    assert watch.lost[0].visible_fraction == 0.5


def test_a_record_keeps_undelivered_parts_and_an_old_one_has_none(tmp_path: Path) -> None:
    facts: Any = {"config_hash": "", "index": 0, "wall": 9.0, "settle": 1.0, "render": 1.0}
    record = BinRecord.from_result(bin_result(), [], undelivered=(LEFT, LOST), **facts)
    path = save_record(record, tmp_path)
    assert load_record(path).undelivered == (LEFT, LOST)
    values = json.loads(path.read_text())
    del next(part for part in (values, *values.values()) if isinstance(part, dict) and "undelivered" in part)[
        "undelivered"
    ]
    path.write_text(json.dumps(values))
    assert load_record(path).undelivered is None
