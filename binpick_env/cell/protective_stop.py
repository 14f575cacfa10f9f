"""The arm's protective stop: where the force at the tool exceeds a limit, the arm brakes, as a real one does."""

import mujoco
import numpy as np

from perception.geometry import Floats

_DAMPING = 1e-4  # of the least squares near singular postures [m^2]: levers under 1 cm add nothing to the force


class ProtectiveStop:
    """Watches the force at the tool through the joints' torques, which is how the UR5e estimates it.

    The external torques are those of contacts and of joints at their ends; grip forces cancel out. What touches the
    links before the tool counts as the force at the tool that would have the same torques.
    """

    def __init__(self, data: mujoco.MjData, arm_dof: int, tcp: int, limit: float) -> None:
        """Watch the arm of a cell.

        Args:
            data: State of the physics; it may change, but not be replaced.
            arm_dof: First of the arm's six degrees of freedom.
            tcp: Number of the site at the tool.
            limit: Force at which the arm stops [N].
        """
        self._data, self._tcp, self._limit = data, tcp, limit**2
        self._arm = slice(arm_dof, arm_dof + 6)
        self._torque = data.qfrc_constraint[self._arm]  # a view, and so always that of the last physics step
        self._jacobian = np.zeros((6, len(data.qvel)))
        self._force_of_torque = np.zeros((3, 6))

    def prepare(self, model: mujoco.MjModel) -> None:
        """Take the arm's posture for the readings that follow; a control period changes it little."""
        mujoco.mj_jacSite(model, self._data, self._jacobian[:3], self._jacobian[3:], self._tcp)
        jacobian = self._jacobian[:, self._arm]
        # torque = jacobian^T @ (force, moment)
        self._force_of_torque = np.linalg.solve(jacobian @ jacobian.T + _DAMPING * np.eye(6), jacobian)[:3]

    def exceeded(self) -> bool:
        """Tell whether the force in the last physics step was over the limit."""
        force: Floats = self._force_of_torque @ self._torque
        return bool(force @ force > self._limit)
