"""Motion without physics: the arm is put where its controller would have brought it while it touches nothing."""

import mujoco
import numpy as np

from binpick_env.cell.simulation import Simulation
from perception.geometry import Floats, invert_transform

_NODES = 25  # of the jaw's table
_REST = 0.2  # that the jaw gets to come to rest at each node [s]


class KinematicMotion:
    """Puts the arm of a simulation into states that its own steps would lead to; what else there is stays as it is.

    A part that is not touched does not feel the difference. Time has to be passed on by the caller.
    """

    def __init__(self, simulation: Simulation) -> None:
        """Measure the jaw's linkage over its commands, on a copy of the state; takes about half a second."""
        self._simulation = simulation
        self._commands = np.linspace(0.0, 1.0, _NODES)
        self._postures = simulation.jaw_postures(self._commands, _REST)

    def jaw_posture(self, command: float) -> Floats:
        """Return the (J,) positions [rad] of the linkage's joints at rest under a command, 0 open to 1 closed."""
        return np.array([np.interp(command, self._commands, column) for column in self._postures.T])

    def place(self, target_before: Floats, target: Floats, gripper: float) -> None:
        """Put the arm where :meth:`Simulation.step` ends when it came from one (6,) target to the next [rad].

        The jaw rests at ``gripper``. Contacts are those of the new place afterwards.
        """
        simulation = self._simulation
        gripper = max(gripper, simulation.gripper_open)
        simulation.put_arm(target_before, target)
        simulation.put_jaw(self.jaw_posture(gripper), gripper)
        simulation.refresh()
        mujoco.mj_collision(simulation.model, simulation.data)

    def carry(self, part: int, target: Floats) -> None:
        """Bring the arm to rest at (6,) ``target`` [rad] with ``part`` as it hangs in the jaw."""
        simulation = self._simulation
        simulation.refresh()
        T_tcp_part = invert_transform(simulation.T_world_tcp) @ simulation.part_poses()[part]
        simulation.put_arm(target, target)
        simulation.refresh()
        simulation.move(part, simulation.T_world_tcp @ T_tcp_part)

    def touches(self) -> bool:
        """Return whether the robot touches anything but itself."""
        ends = self._simulation.robot_ends()
        return bool(np.any(ends[:, 0] != ends[:, 1]))

    def lone_load(self) -> int | None:
        """Return the part that both pads hold, if the robot touches no other and it touches nothing but the robot."""
        simulation = self._simulation
        held = simulation.gripped()
        if len(held) != 1 or simulation.touched_by_gripper().sum() != 1:
            return None
        (part,) = held
        own = simulation.part_of_geom[simulation.data.contact.geom[: simulation.data.ncon]] == part
        elsewhere = own.any(axis=1) & ~own.all(axis=1) & ~simulation.robot_ends().any(axis=1)
        return None if elsewhere.any() else part
