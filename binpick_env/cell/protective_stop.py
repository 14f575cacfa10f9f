"""The arm's protective stop: where the force at the tool exceeds a limit, the arm brakes, as a real one does."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from binpick_env.config import CONTROL_PERIOD
from perception.geometry import Floats

HOLD = 1.0  # longest time that a stop lasts [s]: whoever presses on in vain may try again, once a second

_LEAST_CHANGE = 1e-5  # change of the targets that counts as none [rad]: actions are rounded to 32 bits
_LEVER = 0.05  # a force over the limit is looked for once a joint has its torque over this lever [m]
_DAMPING = 1e-4  # of the least squares near singular postures [m^2]


@dataclass(frozen=True, eq=False, kw_only=True)
class Stop:
    """A stop of the arm.

    Attributes:
        against: (6,) external torques of the joints at which the arm stopped [N m].
        periods: Number of control periods that it lasts yet.
    """

    against: Floats
    periods: int


class ProtectiveStop:
    """Stops the arm where it presses harder than a limit.

    A stop ends when a command leads away from what the arm pressed on, or after `HOLD`.

    The force at the tool follows from the external torques of the joints, as on a UR5e: those of contacts, and of
    joints at their ends. Forces of the grip cancel out. A contact of another link counts as the force at the tool that
    has the same torques.

    Attributes:
        active: The stop that holds the arm; None while nothing does.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, first_dof: int, tcp: int, limit: float | None
    ) -> None:
        """Watch the arm of a cell.

        Args:
            model: Compiled model.
            data: State of the physics; it may change, but not be replaced.
            first_dof: First of the arm's six degrees of freedom.
            tcp: Number of the site at the tool.
            limit: Force at which the arm stops [N]; None lets it press as hard as it can.
        """
        self._model, self._data, self._tcp = model, data, tcp
        self._limit = np.inf if limit is None else limit
        self._arm = slice(first_dof, first_dof + 6)
        self._torque = data.qfrc_constraint[self._arm]  # a view, and so always that of the last physics step
        self._torques = memoryview(self._torque)  # ten times faster to look at than the array
        self._least = _LEVER * self._limit
        self._jacobian = np.zeros((6, model.nv))
        self.active: Stop | None = None

    def begin(self, change: Floats) -> bool:
        """Begin a control period, and return whether the arm stays stopped throughout.

        Args:
            change: (6,) change of the joint targets that is commanded [rad]. It leads away where the external torques
                would do work along it.
        """
        self._change = change
        if self.active is not None:
            against = self.active.against
            away = change @ against > _LEAST_CHANGE * np.linalg.norm(against)
            over = self.active.periods == 0 or away
            self.active = None if over else replace(self.active, periods=self.active.periods - 1)
        return self.active is not None

    def trips(self) -> bool:
        """Tell whether the arm pressed too hard in the last physics step; a stop begins then, unless one holds it."""
        a, b, c, d, e, f = self._torques
        m = self._least
        if -m < a < m and -m < b < m and -m < c < m and -m < d < m and -m < e < m and -m < f < m:
            return False
        presses = self._change @ self._torque <= 0 and np.linalg.norm(self._force()) > self._limit
        if presses:
            periods = round(HOLD / CONTROL_PERIOD) if self.active is None else self.active.periods
            self.active = Stop(against=self._torque.copy(), periods=periods)
        return bool(presses)

    def _force(self) -> Floats:
        """Return the (3,) external force at the tool [N] in the world."""
        mujoco.mj_jacSite(self._model, self._data, self._jacobian[:3], self._jacobian[3:], self._tcp)
        jacobian = self._jacobian[:, self._arm]
        # torque = jacobian^T @ (force, moment)
        force: Floats = np.linalg.solve(jacobian @ jacobian.T + _DAMPING * np.eye(6), jacobian @ self._torque)[:3]
        return force
