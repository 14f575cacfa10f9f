"""The arm's protective stop: where the force at the tool exceeds a limit, the arm brakes, as a real one does."""

import mujoco
import numpy as np

from perception.geometry import Floats

_DAMPING = 1e-4  # of the least squares near singular postures [m^2]: levers under 1 cm add nothing to the force


class ProtectiveStop:
    """Stops the arm where it presses harder than a limit, until a command leads away from what it pressed on.

    The force at the tool follows from the external torques of the joints, as on a UR5e: those of contacts, and of
    joints at their ends. Forces of the grip cancel out. A contact of another link counts as the force at the tool that
    has the same torques.

    Attributes:
        against: (6,) external torques of the joints at which the arm stopped [N m]; None while it is not stopped.
    """

    def __init__(self, data: mujoco.MjData, first_dof: int, tcp: int, limit: float | None) -> None:
        """Watch the arm of a cell.

        Args:
            data: State of the physics; it may change, but not be replaced.
            first_dof: First of the arm's six degrees of freedom.
            tcp: Number of the site at the tool.
            limit: Force at which the arm stops [N]; None lets it press as hard as it can.
        """
        self._data, self._tcp = data, tcp
        self._limit_squared = np.inf if limit is None else limit**2
        self._arm = slice(first_dof, first_dof + 6)
        self._torque = data.qfrc_constraint[self._arm]  # a view, and so always that of the last physics step
        self._jacobian = np.zeros((6, len(data.qvel)))
        self.against: Floats | None = None

    def begin(self, model: mujoco.MjModel, change: Floats) -> bool:
        """Begin a control period, and return whether the arm stays stopped throughout.

        Args:
            model: Compiled model.
            change: (6,) change of the joint targets that is commanded [rad]. It leads away where the external torques
                would do work along it.
        """
        mujoco.mj_jacSite(model, self._data, self._jacobian[:3], self._jacobian[3:], self._tcp)
        jacobian = self._jacobian[:, self._arm]
        # torque = jacobian^T @ (force, moment). The posture changes little in a control period.
        self._force_of_torque = np.linalg.solve(jacobian @ jacobian.T + _DAMPING * np.eye(6), jacobian)[:3]
        self._change = change
        if self.against is not None and change @ self.against > 0:
            self.against = None
        return self.against is not None

    def trips(self) -> bool:
        """Tell whether the arm pressed too hard in the last physics step, and remember against what."""
        force = self._force_of_torque @ self._torque
        if force @ force <= self._limit_squared or self._change @ self._torque > 0:
            return False
        self.against = self._torque.copy()
        return True
