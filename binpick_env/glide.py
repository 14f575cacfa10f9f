"""Motion without physics: the arm is put where its controller would have brought it while it touches nothing."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from binpick_env.config import CONTROL_PERIOD
from binpick_env.robot import GRIPPER
from binpick_env.simulation import Simulation
from perception.geometry import Floats, invert_transform

_NODES = 25  # of the jaw's table
_REST = 0.2  # that the jaw gets to come to rest at each node [s]


class Glide:
    """Puts the arm of a simulation into states that its own steps would lead to; what else there is stays as it is.

    A part that is not touched does not feel the difference. Time has to be passed on by the caller.
    """

    def __init__(self, simulation: Simulation) -> None:
        """Measure the jaw's linkage over its commands, on a copy of the state; takes about half a second."""
        self._simulation = simulation
        model = simulation.model
        joints = [j for j in range(model.njnt) if model.joint(j).name.startswith(GRIPPER)]
        self._jaw_qpos = np.array([model.jnt_qposadr[j] for j in joints])
        self._jaw_dof = np.array([model.jnt_dofadr[j] for j in joints])
        self._commands = np.linspace(0.0, 1.0, _NODES)
        self._postures = self._measure_jaw()

    def jaw_posture(self, command: float) -> Floats:
        """Return the (J,) positions [rad] of the linkage's joints at rest under a command, 0 open to 1 closed."""
        return np.array([np.interp(command, self._commands, column) for column in self._postures.T])

    def place(self, target_before: Floats, target: Floats, gripper: float) -> None:
        """Put the arm where :meth:`Simulation.step` ends when it came from one (6,) target to the next [rad].

        The jaw rests at ``gripper``. Contacts are those of the new place afterwards.
        """
        simulation, data = self._simulation, self._simulation.data
        self._put_arm(target_before, target)
        data.qpos[self._jaw_qpos] = self.jaw_posture(gripper)
        data.qvel[self._jaw_dof] = 0.0
        data.qacc_warmstart[self._jaw_dof] = 0.0
        data.ctrl[simulation._gripper_actuator] = 255.0 * gripper
        simulation.gripper_target = gripper
        simulation.refresh()
        mujoco.mj_collision(simulation.model, data)

    def carry(self, part: int, target: Floats) -> None:
        """Bring the arm to rest at (6,) ``target`` [rad] with ``part`` as it hangs in the jaw."""
        simulation = self._simulation
        simulation.refresh()
        T_tcp_part = invert_transform(simulation.T_world_tcp) @ simulation.part_poses()[part]
        self._put_arm(target, target)
        simulation.refresh()
        simulation._move(part, simulation.T_world_tcp @ T_tcp_part)

    def touches(self) -> bool:
        """Return whether the robot touches anything but itself."""
        return bool(np.any(self._robot_ends()[:, 0] != self._robot_ends()[:, 1]))

    def lone_load(self) -> int | None:
        """Return the part that both pads hold, if the robot touches no other and it touches nothing but the robot."""
        simulation = self._simulation
        held = simulation.gripped()
        if len(held) != 1 or simulation.touched_by_gripper().sum() != 1:
            return None
        (part,) = held
        own = simulation.part_of_geom[simulation.data.contact.geom[: simulation.data.ncon]] == part
        elsewhere = own.any(axis=1) & ~own.all(axis=1) & ~self._robot_ends().any(axis=1)
        return None if elsewhere.any() else part

    def _robot_ends(self) -> NDArray[np.bool_]:
        """Return (C, 2) which ends of the contacts are the robot's."""
        simulation = self._simulation
        return np.array(simulation._is_robot_geom[simulation.data.contact.geom[: simulation.data.ncon]])

    def _put_arm(self, target_before: Floats, target: Floats) -> None:
        simulation, data = self._simulation, self._simulation.data
        # The spline through the targets runs half a control period late.
        data.qpos[simulation._arm_qpos] = (target_before + target) / 2
        data.qvel[simulation._arm_dof] = (target - target_before) / CONTROL_PERIOD
        data.qacc_warmstart[simulation._arm_dof] = 0.0
        simulation._target_before, simulation.target = np.array(target_before), np.array(target)

    def _measure_jaw(self) -> Floats:
        simulation = self._simulation
        data = mujoco.MjData(simulation.model)
        mujoco.mj_copyData(data, simulation.model, simulation.data)
        postures = np.empty((_NODES, len(self._jaw_qpos)))
        for k, command in enumerate(self._commands):
            data.ctrl[simulation._gripper_actuator] = 255.0 * command
            mujoco.mj_step(simulation.model, data, round(_REST / simulation.model.opt.timestep))
            postures[k] = data.qpos[self._jaw_qpos]
        return postures
