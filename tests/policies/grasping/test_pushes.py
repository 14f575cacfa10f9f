"""Pushes of a block whose bin is known: where it is pressed, which way it goes, and what stands in the way."""

from dataclasses import fields

import numpy as np
import pytest

from perception.part import PartModel
from policies.grasping.clearance import clear_among
from policies.grasping.grasps import GraspSettings, sample_grasps
from policies.grasping.gripper import gripper_model
from policies.grasping.observed_scene import ObservedScene
from policies.grasping.pushes import Push, PushSettings, find_pushes
from tests.policies.grasp_cell import WALL, box, candidate, in_bin, look, placed, workspace

BLOCK = (0.06, 0.06, 0.02)
CELL = workspace(yaw=0.7)
AT_WALL = placed(0.0, 0.1, 0.01)  # its face touches the wall on the bin's y side


@pytest.fixture(scope="module")
def gripper():
    return gripper_model()


@pytest.fixture(scope="module")
def grasps(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BINPICK_CACHE", str(tmp_path_factory.mktemp("cache")))
        part = PartModel.from_mesh("block", box(BLOCK))
        return sample_grasps(part, GraspSettings(samples=300, max_grasps=600, max_checked=6000))


def scene_of(grasps, *poses, unknown=()):
    blocks = [box(BLOCK, T) for T in poses]
    frame = look(CELL, [*blocks, *unknown])
    seen = [candidate(CELL, box(BLOCK), T) for T in poses]
    return ObservedScene.from_frame(frame, seen, CELL, grasps.surface, wall=WALL)


def way_in_bin(push):
    return CELL.T_world_bin[:3, :3].T @ push.drag_world


@pytest.mark.slow
def test_a_block_at_a_wall_is_pressed_on_its_top_and_dragged_to_where_a_grasp_is_clear(grasps, gripper) -> None:
    scene = scene_of(grasps, AT_WALL)
    pushes = find_pushes(scene, grasps, gripper)
    assert [push.score for push in pushes] == sorted((push.score for push in pushes), reverse=True)
    for push in pushes:
        tips = in_bin(CELL, push.T_world_tips)
        assert np.all(np.abs(tips[:2, 3] - AT_WALL[:2, 3]) < 0.03)
        assert tips[2, 3] == pytest.approx(0.02, abs=1e-3)
        x, y, z = way_in_bin(push)
        assert y < -0.005  # away from the wall
        assert np.hypot(x, y) <= PushSettings().travel + 1e-9
        assert z == pytest.approx(0.0, abs=1e-12)
    moved = AT_WALL.copy()
    moved[:2, 3] += way_in_bin(pushes[0])[:2]
    clear = clear_among(scene.parts[0].surroundings, CELL.T_world_bin @ moved, grasps, gripper)
    assert clear.any()


def test_a_push_leads_away_from_both_walls_of_a_corner(grasps, gripper) -> None:
    for push in find_pushes(scene_of(grasps, placed(-0.15, -0.1, 0.01)), grasps, gripper):
        x, y, _ = way_in_bin(push)
        assert x > 0
        assert y > 0


def test_a_part_under_another_is_not_pressed_there(grasps, gripper) -> None:
    over = box((0.12, 0.12, 0.02), placed(0.0, 0.07, 0.04))
    assert find_pushes(scene_of(grasps, AT_WALL, unknown=[over]), grasps, gripper) == []


def test_a_part_is_not_pushed_into_what_stands_beside_it(grasps, gripper) -> None:
    fence = [box((0.01, 0.1, 0.05), placed(side * 0.045, 0.08, 0.025)) for side in (-1, 1)]
    fence.append(box((0.1, 0.01, 0.05), placed(0.0, 0.055, 0.025)))
    assert find_pushes(scene_of(grasps, AT_WALL, unknown=fence), grasps, gripper) == []


def test_a_part_is_pulled_out_from_under_what_covers_a_corner_of_it(grasps, gripper) -> None:
    over = box((0.06, 0.06, 0.02), placed(-0.04, 0.06, 0.04))
    pushes = find_pushes(scene_of(grasps, placed(0.0, 0.095, 0.01), unknown=[over]), grasps, gripper)
    assert pushes
    assert all(way_in_bin(push)[0] > 0 for push in pushes)


def test_a_part_that_lies_on_another_slides_over_it(grasps, gripper) -> None:
    lying_on = placed(0.0, 0.1, 0.05)
    under = box((0.3, 0.24, 0.04), placed(0.0, 0.0, 0.02))
    pushes = find_pushes(scene_of(grasps, lying_on, unknown=[under]), grasps, gripper)
    assert pushes
    assert all(way_in_bin(push)[1] < 0 for push in pushes)


def test_pushes_are_alike_that_begin_at_one_place_and_lead_one_way():
    def push(x, angle):
        tips = placed(x, 0.0, 0.02)
        way = np.array([0.05 * np.cos(angle), 0.05 * np.sin(angle), -0.001])
        return Push(T_world_tips=tips, drag_world=way, candidate=0, score=1.0)

    assert push(0.0, 0.0).resembles(push(0.009, np.radians(29)))
    assert not push(0.0, 0.0).resembles(push(0.011, 0.0))
    assert not push(0.0, 0.0).resembles(push(0.0, np.radians(31)))


def test_without_candidates_there_is_no_push(grasps, gripper) -> None:
    assert find_pushes(scene_of(grasps), grasps, gripper) == []


@pytest.mark.parametrize("name", [field.name for field in fields(PushSettings) if field.name != "enabled"])
def test_settings_must_be_positive(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} must be positive and finite, got 0"):
        PushSettings(**{name: 0.0})
    with pytest.raises(ValueError, match=f"{name} must be positive and finite, got inf"):
        PushSettings(**{name: np.inf})


def test_speeds_are_shares() -> None:
    with pytest.raises(ValueError, match=r"press_speed and drag_speed must be at most 1, got 0.02, 5"):
        PushSettings(drag_speed=5.0)


@pytest.mark.parametrize("name", ["press_force", "drag_force"])
def test_a_push_that_would_always_be_broken_off_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=r"press_force and drag_force must be under stop_force, got .* N"):
        PushSettings(**{name: 100.0})
