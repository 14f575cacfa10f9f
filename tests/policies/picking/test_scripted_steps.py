"""The scripted picker taken apart: what it ranks, what it plans, what it executes."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from binpick_env.env import BinPickEnv
from perception.geometry import make_transform, rotation_about
from policies.grasping.failed_grasps import FailedGrasps
from policies.grasping.grasps import flip
from policies.grasping.outcomes import Abstention, GraspCandidate, GraspOutcome
from policies.motion.ik_settings import IkSettings
from policies.motion.planner import StraightLegs, Tool
from policies.picking.attempt_planner import AttemptPlanner
from policies.picking.plan import Plan
from policies.picking.scripted import ScriptedPicker
from policies.picking.settings import PickerSettings
from tests.policies.hand_cell import SMALL_IMAGE, HandCell


@pytest.fixture(scope="module")
def cell() -> HandCell:
    env = BinPickEnv("tee", num_parts=(1, 3), perception="oracle", threads=1, camera=SMALL_IMAGE)
    return HandCell(env, ScriptedPicker(env))


def first_plan(picker: ScriptedPicker) -> Plan:
    plans = (picker.plan(grasp) for grasp in picker.grasps())
    return next(plan for plan in plans if isinstance(plan, Plan))


@pytest.mark.slow
def test_a_pick_is_the_first_plan_executed(cell: HandCell) -> None:
    cell.lay(cell.flat(0.05), cell.flat(-0.08, yaw=0.6))
    plan = first_plan(cell.picker)
    by_hand = cell.picker.execute(plan)
    cell.lay(cell.flat(0.05), cell.flat(-0.08, yaw=0.6))
    picked = cell.picker.pick()
    assert picked.grasp is not None
    np.testing.assert_array_equal(picked.grasp.T_world_tcp, plan.grasp.T_world_tcp)
    assert by_hand.outcome is picked.outcome is GraspOutcome.DELIVERED
    assert (by_hand.t_motion, by_hand.part, by_hand.frame_id) == (picked.t_motion, picked.part, picked.frame_id)
    assert picked.t_compute > by_hand.t_compute > 0.0  # perception and the decision are the pick's


def test_a_part_that_others_seem_to_lie_on_is_lifted_slowly(cell: HandCell) -> None:
    cell.lay(cell.flat(0.05))
    plan, picker = first_plan(cell.picker), cell.picker
    T_world_part = cell.env.candidates[plan.grasp.candidate].T_world_part
    lifts = []
    for buried in (picker.settings.most_buried, picker.settings.most_buried + 0.01):
        grasp = replace(plan.grasp, features={**plan.grasp.features, "buried": buried})
        carry = picker._planner.carry(plan.q_grasp, grasp, T_world_part, picker._pile_height())
        assert carry is not None
        lifts.append(float(carry.t[carry.marks[0]]))
    assert lifts[1] > 1.5 * lifts[0]


def test_grasps_come_by_falling_score(cell: HandCell) -> None:
    cell.lay(cell.flat(0.05), cell.flat(-0.08, yaw=0.6))
    scores = [grasp.score for grasp in cell.picker.grasps()]
    assert len(scores) > 5
    assert scores == sorted(scores, reverse=True)


def test_an_empty_bin_has_no_grasps(cell: HandCell) -> None:
    cell.lay()
    assert cell.picker.grasps() == []


def test_what_reach_refuses_has_no_plan(cell: HandCell) -> None:
    """Along the walls, where the ranking's margin of 1 mm lets grasps through that the planner's 1.5 mm does not."""
    refused = 0
    for y in (0.085, 0.09, 0.095, 0.1):
        cell.lay(cell.flat(0.1, y))
        for grasp in cell.picker.grasps():
            reached = cell.picker.reach(grasp)
            if isinstance(reached, Abstention):
                assert cell.picker.plan(grasp) is reached
                approach = cell.picker._planner._motion.plan_transfer  # as it is without the short cut
                q = cell.picker._planner._ik.solve_grasp(
                    grasp.T_world_tcp, cell.env.simulation.target, opening=grasp.opening
                )
                if q.ok:
                    refused += 1
                    tool, legs = Tool(opening=grasp.opening), StraightLegs(standoff=0.06)
                    assert not approach(cell.env.simulation.target, q.q, tool, legs).ok
    assert refused > 0


def test_a_grasp_that_is_reached_is_reached(cell: HandCell) -> None:
    cell.lay(cell.flat())
    grasp = cell.picker.grasps()[0]
    reached = cell.picker.reach(grasp)
    assert not isinstance(reached, Abstention)
    T_world_tcp = cell.picker._planner._ik.tcp_pose(reached.q)
    np.testing.assert_allclose(T_world_tcp[:3, 3], grasp.T_world_tcp[:3, 3], atol=1e-3)
    assert reached.min_singular_value > 0.1


def test_a_plan_is_for_its_own_frame(cell: HandCell) -> None:
    cell.lay(cell.flat())
    plan = first_plan(cell.picker)
    cell.env.look()
    with pytest.raises(ValueError, match=r"the plan is for frame 1, but the last one is 2: plan again"):
        cell.picker.execute(plan)
    assert cell.log == []


# --- what was tried in vain ------------------------------------------------------------------------------------------


def grasp_at(x: float, row: int = 0, score: float = 0.5, tilt: float = 0.0) -> GraspCandidate:
    T = make_transform(np.diag([1.0, -1.0, -1.0]) @ rotation_about((1, 0, 0), tilt), (x, 0.0, 0.0))
    return GraspCandidate(T_world_grasp=T, T_world_tcp=T, width=0.03, opening=0.05, candidate=row, score=score)


def parts_at(*places: float) -> list[Any]:
    return [SimpleNamespace(centre_world=np.array([x, 0.0, 0.0])) for x in places]


def test_nothing_failed_changes_nothing() -> None:
    ranked = [grasp_at(0.0, 0), grasp_at(0.1, 1)]
    assert FailedGrasps(radius=0.02).without_failed(ranked, parts_at(0.0, 0.1)) == ranked


def test_parts_that_failed_come_last_and_failed_grasps_not_at_all() -> None:
    failed = FailedGrasps(radius=0.02)
    failed.add(np.array([0.001, 0.0, 0.0]), grasp_at(0.0).T_world_grasp)
    same, turned, other, also = grasp_at(0.007, 0), grasp_at(0.0, 0, tilt=0.3), grasp_at(0.1, 1), grasp_at(0.009, 0)
    assert failed.without_failed([same, turned, also, other], parts_at(0.0, 0.1)) == [other, turned, also]


def test_the_jaw_turned_by_half_is_the_same_grasp() -> None:
    failed = FailedGrasps(radius=0.02)
    failed.add(np.zeros(3), flip(grasp_at(0.0).T_world_grasp))
    assert failed.without_failed([grasp_at(0.0)], parts_at(0.0)) == []


@pytest.mark.parametrize(("distance", "suspect"), [(0.019, True), (0.021, False)])
def test_a_part_is_known_by_where_its_centre_is(distance: float, suspect: bool) -> None:
    failed = FailedGrasps(radius=0.02)
    failed.add(np.zeros(3), np.eye(4))
    assert failed.suspect(np.array([0.0, distance, 0.0])) is suspect


def test_postures_are_searched_as_the_settings_say(cell: HandCell) -> None:
    settings = PickerSettings(ik=IkSettings(restarts=0))
    planner = AttemptPlanner(cell.env.config, cell.env.part.model, cell.picker.gripper, settings)
    assert planner._ik.settings.restarts == 0
    assert cell.picker._planner._ik.settings.restarts == 8
