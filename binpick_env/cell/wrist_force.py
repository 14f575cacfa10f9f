"""A force sensor at the wrist: the weight that the gripper carries, with stated noise."""

from dataclasses import dataclass

import mujoco
import numpy as np

from binpick_env.cell.simulation import Simulation

GRAVITY = 9.81  # [m/s^2]


@dataclass(frozen=True, kw_only=True)
class WristForceNoise:
    """Errors of a reading, assumed and not measured on a sensor. A reading is the mean over one control period."""

    noise: float = 0.2  # standard deviation of a reading, independent from one to the next [N]
    drift: float = 0.1  # standard deviation of the error that stays from one taring to the next [N]

    def __post_init__(self) -> None:
        if not (self.noise >= 0 and self.drift >= 0):
            raise ValueError(f"noise and drift must be at least 0 N, got {self.noise} and {self.drift}")

    def deviation(self, readings: int) -> float:
        """Return the standard deviation of the mean of ``readings`` readings [N]."""
        return float(np.hypot(self.noise / np.sqrt(readings), self.drift))


class WristForceSensor:
    """Reads the vertical force of the parts on the gripper. The gripper's own weight and inertia are compensated."""

    def __init__(self, simulation: Simulation, noise: WristForceNoise, rng: np.random.Generator) -> None:
        """Read a simulation with errors drawn from ``rng``."""
        self._simulation, self._noise, self._rng = simulation, noise, rng
        self.tare()

    def tare(self) -> None:
        """Set the reading to zero with nothing in the gripper: the error that stays is drawn anew."""
        self._offset = float(self._noise.drift * self._rng.normal())

    def read(self) -> float:
        """Return the force [N], positive downwards."""
        return carried_load(self._simulation) + self._offset + float(self._noise.noise * self._rng.normal())


def carried_load(simulation: Simulation) -> float:
    """Return the vertical force of the parts on the robot [N], positive downwards, without error."""
    model, data = simulation.model, simulation.data
    robot, part = simulation.robot_ends(), simulation.part_ends()
    load, wrench = 0.0, np.zeros(6)
    for c in np.flatnonzero((robot[:, 0] & (part[:, 1] >= 0)) | (robot[:, 1] & (part[:, 0] >= 0))):
        mujoco.mj_contactForce(model, data, int(c), wrench)
        upwards = float(wrench[:3] @ data.contact.frame[c].reshape(3, 3)[:, 2])  # on the second of the two geoms
        load += upwards if robot[c, 0] else -upwards
    return load
