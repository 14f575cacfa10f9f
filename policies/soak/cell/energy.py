"""Energy of the parts, and which of them the robot drives."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from binpick_env.cell.simulation import Simulation
from perception.geometry import Floats, matrix_from_quat


class EnergyMeter:
    """Measures the mechanical energy of the parts, which all have the same mass and inertia."""

    def __init__(self, simulation: Simulation) -> None:
        """Look up where the parts' positions and velocities stand."""
        self._simulation = simulation
        model = simulation.model
        joints = [model.joint(f"part_{i}") for i in range(simulation.capacity)]
        body = joints[0].bodyid[0]
        self._quat = np.array([joint.qposadr[0] for joint in joints])[:, None] + np.arange(3, 7)
        self._velocity = np.array([joint.dofadr[0] for joint in joints])[:, None] + np.arange(3)
        self._mass, self._centre = float(model.body_mass[body]), np.array(model.body_ipos[body])
        self._gravity = -float(model.opt.gravity[2])
        self._R_body_axes = matrix_from_quat(model.body_iquat[body])
        self._inertia = np.array(model.body_inertia[body])

    def energies(self) -> Floats:
        """Return the (capacity,) kinetic and potential energies of the parts together [J], which a fall keeps."""
        data = self._simulation.data
        R_world_body = matrix_from_quat(data.qpos[self._quat])
        velocity, spin = data.qvel[self._velocity], data.qvel[self._velocity + 3]  # in the world, and in the body
        of_centre = velocity + (R_world_body @ np.cross(spin, self._centre)[..., None])[..., 0]
        about_axes = spin @ self._R_body_axes
        heights = data.qpos[self._quat[:, 0] - 1] + R_world_body[:, 2] @ self._centre
        energies: Floats = 0.5 * self._mass * (of_centre**2).sum(axis=1) + 0.5 * about_axes**2 @ self._inertia
        energies += self._mass * self._gravity * heights
        return energies


class DrivenParts:
    """Collects, over all substeps of a step, which parts the robot touches, directly or through other parts."""

    def __init__(self, simulation: Simulation) -> None:
        """Collect nothing yet."""
        self._simulation = simulation
        robot = np.array([simulation.model.body("base").id == root for root in simulation.model.body_rootid])
        # A number for each geom: a part from 0 on, the robot after them, anything else after that.
        owner = np.where(simulation.part_of_geom >= 0, simulation.part_of_geom, simulation.capacity + 1)
        self._owner = np.where(robot[simulation.model.geom_bodyid], simulation.capacity, owner)
        self.clear()

    def clear(self) -> None:
        """Forget what was collected."""
        self._pairs: list[NDArray[np.int32]] = []

    def collect(self, *_: object) -> None:
        """Add the contacts of this moment; it has the form of MuJoCo's callbacks."""
        self._pairs.append(self._simulation.data.contact.geom[: self._simulation.data.ncon].copy())

    def mask(self) -> NDArray[np.bool_]:
        """Return the (capacity,) mask of the parts that the robot touched, or that touched such a part, and so on."""
        capacity = self._simulation.capacity
        first, second = self._owner[np.concatenate(self._pairs)].T
        touching = np.zeros((capacity + 2, capacity + 2), dtype=bool)
        touching[first, second] = touching[second, first] = True
        touching[capacity + 1] = False  # walls and floors pass nothing on
        driven = np.arange(capacity + 2) == capacity
        while True:
            wider = driven | touching[driven].any(axis=0)
            wider[capacity + 1] = False
            if np.array_equal(wider, driven):
                return np.array(driven[:capacity])
            driven = wider


def set_control_callback(callback: object) -> None:
    """Let MuJoCo call a function in every substep of every simulation of this process; None for none."""
    mujoco.set_mjcb_control(callback)
