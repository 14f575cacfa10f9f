"""The picker's settings against the simulated gripper."""

import mujoco
import pytest

from binpick_env.cell.robot import GRIPPER, GRIPPER_ACTUATOR, TCP_SITE, robot_spec
from binpick_env.config import RobotConfig
from policies.grasping.grasps import GraspSettings
from policies.grasping.gripper import gripper_model
from policies.picking.settings import PickerSettings

PLATE = "plate"


def closed_position(width: float | None) -> tuple[float, int]:
    """Close the jaw on a weightless plate [m], or on nothing; return its position in [0, 1] and the contacts."""
    spec = robot_spec(RobotConfig())
    spec.option.gravity = [0.0, 0.0, 0.0]
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    if width is not None:
        tcp = data.site(TCP_SITE)
        body = spec.worldbody.add_body(name=PLATE, pos=tcp.xpos)
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_XYAXES
        R = tcp.xmat.reshape(3, 3)
        body.alt.xyaxes = [*R[:, 0], *R[:, 1]]
        body.add_geom(name=PLATE, type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.01, width / 2, 0.01], mass=0.02)
        body.add_freejoint()
        model = spec.compile()
        data = mujoco.MjData(model)
    data.ctrl[model.actuator(GRIPPER_ACTUATOR).id] = 255.0
    mujoco.mj_step(model, data, nstep=600)
    driver = data.joint(GRIPPER + "left_driver_joint").qpos[0]
    plate = -1 if width is None else model.geom(PLATE).id
    return float(driver / model.joint(GRIPPER + "left_driver_joint").range[1]), int((data.contact.geom == plate).sum())


@pytest.mark.parametrize("width", [GraspSettings().min_width, 0.004, 0.006])
def test_a_jaw_that_holds_a_thin_plate_does_not_count_as_empty(width: float) -> None:
    position, contacts = closed_position(width)
    assert contacts >= 2  # the plate is still between the pads
    assert position < gripper_model().control(PickerSettings().empty_gap) - 0.005


def test_a_jaw_that_closed_on_nothing_counts_as_empty() -> None:
    position, _ = closed_position(None)
    assert position > gripper_model().control(PickerSettings().empty_gap) + 0.005


@pytest.mark.parametrize("name", ["slow_lift", "approach_speed", "carry_scale"])
@pytest.mark.parametrize("value", [0.0, -0.1, 1.1, float("nan")])
def test_speeds_are_shares(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"{name} must be in \(0, 1\], got {value}"):
        PickerSettings(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("wrong", [{"grasps_tried": 0}, {"most_buried": -0.1}, {"standoff": 0.0}], ids=str)
def test_numbers_and_lengths_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"grasps_tried must be at least 1, most_buried and release_height at least 0"):
        PickerSettings(**wrong)  # type: ignore[arg-type]
