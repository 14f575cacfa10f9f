"""Kinematic motion: the arm is put where its controller would have brought it, as long as it touches nothing."""

import numpy as np

from binpick_env.cell.simulation import Simulation
from perception.geometry import Floats, invert_transform

_COMMANDS = 25  # number of gripper commands at which the jaw's linkage is measured
_REST = 0.2  # time that the jaw gets to come to rest at each command [s]


class KinematicMotion:
    """Puts the arm of a simulation into states that its own steps would lead to, and changes nothing else.

    Parts that are not touched behave as with the physics. The caller has to advance the time.
    """

    def __init__(self, simulation: Simulation) -> None:
        """Measure the jaw's linkage under each command, on a copy of the state; takes about half a second."""
        self._simulation = simulation
        self._commands = np.linspace(0.0, 1.0, _COMMANDS)
        self._postures = simulation.jaw_postures(self._commands, _REST)

    def jaw_posture(self, command: float) -> Floats:
        """Return the (J,) joint positions of the linkage at rest [rad] under a command from 0 open to 1 closed."""
        return np.array([np.interp(command, self._commands, column) for column in self._postures.T])

    def place(self, target_before: Floats, target: Floats, gripper: float) -> None:
        """Put the arm where :meth:`Simulation.step` would leave it, with the jaw at rest; contacts are updated.

        Args:
            target_before: (6,) joint targets of the step before [rad].
            target: (6,) joint targets of the step [rad].
            gripper: Gripper command, 0 open to 1 closed.
        """
        simulation = self._simulation
        gripper = max(gripper, simulation.gripper_open)
        simulation.put_arm(target_before, target)
        simulation.put_jaw(self.jaw_posture(gripper), gripper)
        simulation.refresh_contacts()

    def carry(self, part: int, target: Floats) -> None:
        """Put the arm at rest at (6,) joint positions [rad], with part ``part`` in the jaw as it is held now."""
        simulation = self._simulation
        simulation.refresh()
        T_tcp_part = invert_transform(simulation.T_world_tcp) @ simulation.part_poses()[part]
        simulation.put_arm(target, target)
        simulation.refresh()
        simulation.move(part, simulation.T_world_tcp @ T_tcp_part)

    def touches(self) -> bool:
        """Tell whether the robot touches anything but itself."""
        ends = self._simulation.robot_ends()
        return bool(np.any(ends[:, 0] != ends[:, 1]))

    def lone_load(self) -> int | None:
        """Return the part that both pads hold, or None.

        It is also None where the robot touches another part as well, or the part touches anything but the robot.
        """
        simulation = self._simulation
        held = simulation.gripped()
        if len(held) != 1 or simulation.touched_by_robot().sum() != 1:
            return None
        (part,) = held
        own = simulation.part_ends() == part
        elsewhere = own.any(axis=1) & ~own.all(axis=1) & ~simulation.robot_ends().any(axis=1)
        return None if elsewhere.any() else part
