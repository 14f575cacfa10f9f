"""Collision checks of postures and paths."""

import mujoco
import numpy as np
import pytest

from binpick_env.cell.robot import HOME
from binpick_env.config import CellConfig, RobotConfig
from perception.geometry import make_transform, rotation_about
from policies.motion.path_checker import PathChecker
from policies.motion.planning_scene import MAX_CLEARANCE, PlanningScene
from tests.policies.motion.arm_motions import DOWN, posture


def distance_by_mujoco(scene, q):
    """Smallest mj_geomDistance between any robot geom that may touch the cell and any of the cell's."""
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[:6] = q
    mujoco.mj_forward(model, data)
    still = model.body_weldid[model.geom_bodyid] == 0
    pairs = [
        (a, b)
        for a in np.flatnonzero(~still)
        for b in np.flatnonzero(still)
        if model.geom_conaffinity[a] & model.geom_contype[b]
        and not (model.geom(b).name == "arm_base" and model.body(model.geom_bodyid[a]).name == "upper_arm_link")
    ]
    return min(mujoco.mj_geomDistance(model, data, a, b, 0.5, None) for a, b in pairs)


def test_contacts_agree_with_mujocos_distances(scene, ik):
    rng = np.random.default_rng(4)
    verdicts = []
    for _ in range(60):
        q = ik.solve(make_transform(DOWN, rng.uniform((0.3, -0.25, 0.0), (0.7, 0.25, 0.25))), HOME).q
        distance = distance_by_mujoco(scene, q)
        touches = [c for c in scene.contacts(q, clearance=0.01) if not _self_contact(c)]
        if abs(distance - 0.01) > 1e-4:
            assert bool(touches) == (distance < 0.01)
        verdicts.append(distance < 0.01)
    assert 5 < sum(verdicts) < 55


def _self_contact(contact):
    cell = ("bin/", "tray/", "table", "pedestal", "arm_base")
    return not (contact.first.startswith(cell) or contact.second.startswith(cell))


def test_checker_flags_a_posture_in_the_wall_and_passes_a_free_one(scene, ik):
    checker = PathChecker(scene)
    closing_along_x = DOWN @ rotation_about((0, 0, 1), np.pi / 2)  # or the open jaw would stand astride the wall
    inside = ik.solve(make_transform(closing_along_x, (0.5, 0.19, 0.10)), HOME).q
    assert distance_by_mujoco(scene, inside) < 0
    assert checker.check(HOME[None]).free
    verdict = checker.check(np.vstack([HOME, inside]))
    assert not verdict.free
    assert "bin/" in verdict.reason


def test_checker_sees_between_the_knots(scene, ik):
    """Both ends of this path are free, but the way between leads through the bin's wall."""
    q_in, q_out = posture(ik, (0.5, 0.0, 0.06)), posture(ik, (0.5, -0.30, 0.06))
    checker = PathChecker(scene)
    assert checker.check(q_in[None]).free
    assert checker.check(q_out[None]).free
    assert not checker.check(np.vstack([q_in, q_out])).free


def test_arm_folded_into_itself_is_a_collision(scene):
    folded = np.array([0.0, -1.2, 2.9, -np.pi / 2, -np.pi / 2, 0.0])
    assert any(_self_contact(contact) for contact in scene.contacts(folded))


def test_carried_points_must_clear_rim_and_pile(scene, ik):
    checker = PathChecker(scene)
    over_wall = posture(ik, (0.5, 0.185, 0.19))[None]  # the rim is at 0.14
    hanging = np.array([[0.0, 0.0, 0.045]])
    assert checker.check(over_wall, points_tcp=hanging).free
    assert not checker.check(over_wall, points_tcp=hanging, pile_clearance=0.01).free
    over_pile = posture(ik, (0.5, 0.0, 0.16))[None]
    assert checker.check(over_pile, points_tcp=hanging).free
    low = checker.check(over_pile, points_tcp=hanging, obstacle_height=lambda points: np.full(len(points), 0.12))
    assert not low.free
    assert "-5.0 mm above the surface" in low.reason


def test_static_height_is_that_of_the_boxes(scene):
    points = np.array([[0.5, 0, 1], [0.5, 0.185, 1], [0.5, -0.185, 1], [0.365, 0, 1], [0.42, -0.42, 1], [0.0, 0.4, 1]])
    np.testing.assert_allclose(scene.static_height(points), [0.02, 0.14, 0.14, 0.14, 0.01, 0.0], atol=1e-12)
    assert scene.static_height(np.array([[9.0, 9.0, 0.0]]))[0] == -np.inf


def test_tcp_poses_are_read_anew_and_belong_to_the_caller(scene, monkeypatch):
    """No view of the simulation's data outlives a placement, and no later query changes a returned pose."""
    q = np.vstack([HOME, HOME + 0.1, HOME - 0.2])
    poses = scene.tcp_poses(q)
    before = poses.copy()
    scene.contacts(HOME + 0.3)
    np.testing.assert_array_equal(poses, before)
    place = PlanningScene._place

    def place_in_new_data(self, posture, opening):
        self._data = mujoco.MjData(self.model)
        place(self, posture, opening)

    monkeypatch.setattr(PlanningScene, "_place", place_in_new_data)
    np.testing.assert_array_equal(scene.tcp_poses(q), before)


def test_refined_path_moves_the_tip_in_small_steps(scene):
    checker = PathChecker(scene)
    samples = checker.refine(np.vstack([HOME, HOME + np.array([0.8, 0, 0, 0, 0, 0])]))
    tips = scene.tcp_poses(samples)[:, :3, 3]
    assert np.linalg.norm(np.diff(tips, axis=0), axis=1).max() < 0.025


@pytest.mark.parametrize("opening", [0.0, 0.02, 0.05, 0.085])
def test_jaw_posture_opens_as_asked(scene, opening):
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[6:] = scene.jaw_posture(opening)
    mujoco.mj_kinematics(model, data)
    left, right = model.geom("gripper/left_pad1").id, model.geom("gripper/right_pad1").id
    assert mujoco.mj_geomDistance(model, data, left, right, 0.2, None) == pytest.approx(opening, abs=1e-3)


def test_a_limited_jaw_opens_no_wider():
    narrow = PlanningScene(CellConfig(robot=RobotConfig(jaw=0.05)))
    assert narrow.max_opening == 0.05
    np.testing.assert_array_equal(narrow.jaw_posture(0.08), narrow.jaw_posture(0.05))
    q = HOME.copy()
    narrow.contacts(q)  # the open jaw's shapes are those of 50 mm
    left, right = (narrow.model.geom(f"gripper/{side}_pad1").id for side in ("left", "right"))
    opening = mujoco.mj_geomDistance(narrow.model, narrow._data, left, right, 0.2, None)
    assert opening == pytest.approx(0.05, abs=1e-3)


def test_a_closed_jaw_fits_where_an_open_one_does_not(scene, ik):
    """The tips reach 2 cm below the rim, 3.5 cm from the wall that the jaw opens towards."""
    q = ik.solve(make_transform(DOWN, (0.5, 0.145, 0.12)), HOME).q
    assert scene.contacts(q)
    assert not scene.contacts(q, opening=0.0)


def test_a_single_contact_is_reported(scene, ik):
    """Only one pad of a tilted, closed jaw comes within the largest clearance of the table."""
    tilted = rotation_about((1, 0, 0), 0.3) @ rotation_about((0, 1, 0), 0.2) @ DOWN
    q = ik.solve(make_transform(tilted, (0.35, -0.6, 0.05)), HOME, opening=0.0).q
    (contact,) = scene.contacts(q, opening=0.0, clearance=MAX_CLEARANCE)
    assert {contact.first, contact.second} == {"table", "gripper/right_pad1"}
    assert contact.distance == pytest.approx(0.029, abs=5e-4)
    assert contact.gripper_on_cell


def test_clearance_beyond_what_is_modelled_is_refused(scene):
    with pytest.raises(ValueError, match="clearance must be in"):
        scene.contacts(HOME, clearance=MAX_CLEARANCE + 0.01)
    with pytest.raises(ValueError, match="clearance must be in"):
        scene.contacts(HOME, clearance=-MAX_CLEARANCE - 0.01)
