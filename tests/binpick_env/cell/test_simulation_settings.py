"""What a setting does to the physics."""

from collections.abc import Callable
from dataclasses import fields, replace

import mujoco
import numpy as np
import pytest

from binpick_env.cell.robot import FINGER_PADS, HOME
from binpick_env.cell.simulation import Simulation
from binpick_env.config import CONTROL_PERIOD, BinConfig, CellConfig, ContactConfig, RobotConfig, TrayConfig
from tests.binpick_env.small_cell import small_simulation, wait


def test_the_contact_options_of_the_gripper_arrive() -> None:
    option = small_simulation().model.opt
    assert option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert option.impratio == 10.0
    assert option.noslip_iterations == 5
    assert option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert option.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP
    assert option.sleep_tolerance == 0.01
    assert option.timestep == 0.002


@pytest.mark.parametrize("name", [name for side in FINGER_PADS for name in side])
def test_the_pads_resist_twisting(shared_simulation: Simulation, name: str) -> None:
    pad = shared_simulation.model.geom(name)
    assert pad.condim == 6
    np.testing.assert_allclose(pad.friction, (0.7 if name.endswith("1") else 0.6, 0.005, 0.0005))


def probe(simulation: Simulation, start: tuple[float, float, float], direction: tuple[float, float, float]) -> float:
    """Return the distance from a world point to the first fixed geom along a direction [m]."""
    hit = np.zeros(1, np.int32)
    return float(mujoco.mj_ray(simulation.model, simulation.data, start, direction, None, 1, -1, hit))


def across(simulation: Simulation, position: tuple[float, float]) -> tuple[float, float]:
    """Return the inner size of the box at a position along the world's x and y, 3 cm above the table."""
    start = (*position, 0.03)
    x, y = (
        probe(simulation, start, direction) + probe(simulation, start, opposite)
        for direction, opposite in (((1, 0, 0), (-1, 0, 0)), ((0, 1, 0), (0, -1, 0)))
    )
    return x, y


def floor_and_rim(simulation: Simulation, position: tuple[float, float], beside: float) -> tuple[float, ...]:
    """Return the heights of a box's floor and of its wall, ``beside`` its middle along the world's x [m]."""
    top = 0.16  # above every wall, below the resting fingers
    return tuple(top - probe(simulation, (position[0] + x, position[1], top), (0, 0, -1)) for x in (0.0, beside))


def contact_of(name: str) -> Callable[[Simulation], object]:
    """Return how to read a contact property, which must be the same on every part, the bin and the tray."""

    def read(simulation: Simulation) -> tuple[float, ...]:
        model = simulation.model
        boxes = [g for g in range(model.ngeom) if model.geom(g).name.startswith(("bin/", "tray/"))]
        boxes = [g for g in boxes if model.geom_contype[g]]  # the tray's floor is one to see and one to touch
        pieces = [g for g in range(model.ngeom) if "/piece_" in model.geom(g).name]
        assert len(boxes) == 10
        assert len(pieces) == len(simulation.part.pieces) * simulation.capacity
        values = np.atleast_2d(getattr(model, name).T).T[[*boxes, *pieces]]
        assert (values == values[0]).all()
        return tuple(values[0].tolist())

    return read


def speed_of_a_joint(simulation: Simulation) -> float:
    simulation.step(HOME + 1.0, 0.0)
    return float((simulation.target - HOME)[0] / CONTROL_PERIOD)


def time_of_the_jaw(simulation: Simulation) -> float:
    simulation.step(HOME, 1.0)
    return CONTROL_PERIOD / simulation.gripper_target


def opening_of_the_jaw(simulation: Simulation) -> float:
    """Return how far the pads are apart after an attempt to close the jaw and to open it wide [m], in tenths of mm."""
    wait(simulation, 0.2, gripper=1.0)
    wait(simulation, 1.0, gripper=0.0)
    left, right = (simulation.model.geom(side[0]).id for side in FINGER_PADS)
    mujoco.mj_kinematics(simulation.model, simulation.data)
    return round(float(mujoco.mj_geomDistance(simulation.model, simulation.data, left, right, 0.2, None)), 4)


def length_of_ten_steps(simulation: Simulation) -> tuple[float, int]:
    wait(simulation, 10 * CONTROL_PERIOD)
    return simulation.time, simulation.substeps


def bin_turn(simulation: Simulation) -> float:
    x_axis = simulation.data.body("bin").xmat.reshape(3, 3)[:, 0]
    return float(np.arctan2(x_axis[1], x_axis[0]))


HERE = (0.45, 0.1)
SETTINGS = {
    "bin.inner_size": (BinConfig(inner_size=(0.3, 0.2, 0.1)), lambda s: across(s, (0.5, 0.0)), (0.2, 0.3)),
    "bin.inner_size, height": (
        BinConfig(inner_size=(0.3, 0.2, 0.1)),
        lambda s: floor_and_rim(s, (0.5, 0), 0.11),
        (0.02, 0.12),
    ),
    "bin.wall": (BinConfig(wall=0.025), lambda s: floor_and_rim(s, (0.5, 0), 0.154), (0.025, 0.145)),
    "bin.position": (BinConfig(position=HERE), lambda s: (*across(s, HERE), *s.data.body("bin").xpos[:2]), None),
    "bin.yaw": (BinConfig(yaw=0.5), bin_turn, 0.5),
    "tray.inner_size": (TrayConfig(inner_size=(0.2, 0.15, 0.05)), lambda s: across(s, (0.42, -0.42)), (0.2, 0.15)),
    "tray.wall": (TrayConfig(wall=0.02), lambda s: floor_and_rim(s, (0.42, -0.42), 0.13), (0.02, 0.08)),
    "tray.position": (TrayConfig(position=(0.3, 0.4)), lambda s: across(s, (0.3, 0.4)), (0.24, 0.24)),
    "robot.pedestal_height": (RobotConfig(pedestal_height=0.3), lambda s: s.data.body("base").xpos[2], 0.3),
    "robot.max_velocity": (RobotConfig(max_velocity=1.5), speed_of_a_joint, 1.5),
    "robot.gripper_time": (RobotConfig(gripper_time=1.0), time_of_the_jaw, 1.0),
    "robot.jaw": (RobotConfig(jaw=0.04), opening_of_the_jaw, 0.04),
    "robot.protective_stop": (RobotConfig(protective_stop=40.0), lambda s: s._stop._limit, 40.0),
    "contact.condim": (ContactConfig(condim=4), contact_of("geom_condim"), (4,)),
    "contact.friction": (ContactConfig(friction=(0.3, 0.01, 0.001)), contact_of("geom_friction"), (0.3, 0.01, 0.001)),
    "contact.solref": (ContactConfig(solref=(0.02, 0.9)), contact_of("geom_solref"), (0.02, 0.9)),
    "contact.solimp": (
        ContactConfig(solimp=(0.8, 0.9, 0.002, 0.4, 1.5)),
        contact_of("geom_solimp"),
        (0.8, 0.9, 0.002, 0.4, 1.5),
    ),
    "contact.joint_damping": (
        ContactConfig(joint_damping=3e-4),
        lambda s: s.model.dof_damping[s.model.joint("part_2").dofadr[0] :],
        (3e-4,) * 6,
    ),
    "contact.sleep_tolerance": (ContactConfig(sleep_tolerance=0.002), lambda s: s.model.opt.sleep_tolerance, 0.002),
    "timestep": (0.004, length_of_ten_steps, (0.4, 10)),
}
SETTINGS["bin.position"] = (*SETTINGS["bin.position"][:2], (0.26, 0.36, *HERE))
# The first two are the planner's, see tests/policies/motion; the camera's are in test_env_observations.py, and the
# calibration's, which the physics do not know, in test_options.py.
ELSEWHERE = {"robot.max_acceleration", "robot.max_jerk", "camera", "calibration"}


@pytest.mark.slow
@pytest.mark.parametrize("name", SETTINGS)
def test_a_setting_arrives(shared_simulation: Simulation, name: str) -> None:
    value, observe, expected = SETTINGS[name]
    shared_simulation.reset()
    assert observe(shared_simulation) != pytest.approx(expected, abs=1e-6)
    config = replace(CellConfig(), **{name.split(".")[0]: value})
    assert observe(small_simulation(config=config)) == pytest.approx(expected, abs=1e-6)


def test_every_setting_is_tested() -> None:
    names = set()
    for field in fields(CellConfig):
        value = getattr(CellConfig(), field.name)
        inner = field.name not in ("camera", "calibration", "timestep")
        names |= {f"{field.name}.{f.name}" for f in fields(value)} if inner else {field.name}
    assert names == {name.split(",")[0] for name in SETTINGS} | ELSEWHERE


def test_there_is_memory_for_the_contacts_of_a_dense_pile() -> None:
    """28 gears of 8 pieces each overran 128 MB while they fell, and the step after that failed."""
    assert small_simulation().model.narena >= 512 << 20
