"""The scripted picker with a jaw that opens less than the gripper could."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh

from binpick_env.cell.robot import FINGER_PADS
from binpick_env.config import CellConfig, RobotConfig
from binpick_env.env import BinPickEnv
from policies.grasping.outcomes import GraspOutcome
from policies.picking.fast_execution import fast_pickers
from policies.picking.plan import Plan
from policies.picking.scripted import ScriptedPicker
from tests.policies.hand_cell import SMALL_IMAGE, HandCell, hand_cell

JAW = 0.05
NARROW = CellConfig(robot=RobotConfig(jaw=JAW))


@pytest.fixture(scope="module")
def narrow() -> HandCell:
    return hand_cell("tee", 1, config=NARROW)


def pad_distance(env: BinPickEnv) -> float:
    """Return the smallest distance between the upper boxes of both pads [m]."""
    model, data = env.simulation.model, env.simulation.data
    left, right = (model.geom(pads[0]).id for pads in FINGER_PADS)
    return mujoco.mj_geomDistance(model, data, left, right, 0.2, None)


def test_no_grasp_and_no_plan_opens_wider_than_the_jaw(narrow: HandCell) -> None:
    narrow.lay(narrow.flat(0.03, yaw=0.4))
    grasps = narrow.picker.grasps()
    assert len(grasps) > 3
    assert max(grasp.opening for grasp in grasps) <= JAW - 0.001 + 1e-12
    widest = narrow.picker.gripper.control(JAW)
    plans = [narrow.picker.plan(grasp) for grasp in grasps[:3]]
    openings = [plan.grasp.opening for plan in plans if isinstance(plan, Plan)]
    assert openings
    assert all(narrow.picker.gripper.control(opening) > widest > 0.3 for opening in openings)


@pytest.mark.parametrize("fast", [pytest.param(False, marks=pytest.mark.slow), True])
def test_an_attempt_opens_no_wider_than_the_jaw(narrow: HandCell, fast: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = narrow
    if fast:
        monkeypatch.setattr(cell, "picker", fast_pickers(cell.env, None, "oracle")[0])
    cell.lay(cell.flat(0.03, yaw=0.4))
    openings = [pad_distance(cell.env)]
    step = cell.env.simulation.step

    def watched(joint_targets: np.ndarray, gripper: float) -> None:
        step(joint_targets, gripper)
        openings.append(pad_distance(cell.env))

    monkeypatch.setattr(cell.env.simulation, "step", watched)
    assert cell.picker.pick().outcome is GraspOutcome.DELIVERED
    openings.append(pad_distance(cell.env))
    assert len(openings) > 10
    assert min(openings) < 0.03 < JAW - 0.003 < max(openings) < JAW + 0.001


@pytest.mark.slow
@pytest.mark.parametrize(
    ("side", "jaw", "text"),
    [
        (0.06, JAW, r"jaw \(stroke 50 mm\) finds no grasp on 'block'.*60 mm apart"),
        (0.09, None, r"jaw \(stroke 85 mm\) finds no grasp on 'block'.*90 mm apart"),
    ],
)
def test_a_part_wider_than_the_jaw_is_refused_with_both_widths(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, side: float, jaw: float | None, text: str
) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path))
    trimesh.creation.box((side, side, side)).export(tmp_path / "block.stl")
    options: dict[str, Any] = {"perception": "oracle", "symmetry": "none", "jaw": jaw, "camera": SMALL_IMAGE}
    env = BinPickEnv(str(tmp_path / "block.stl"), num_parts=1, **options)
    with pytest.raises(ValueError, match=text):
        ScriptedPicker(env)
