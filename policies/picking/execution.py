"""One attempt, step by step: trajectories, jaw, force limit, and what the outcome depends on."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from binpick_env.cell.delivery import Delivery
from binpick_env.config import CONTROL_PERIOD
from binpick_env.env import BinPickEnv
from perception.geometry import Floats
from policies.grasping.outcomes import GraspOutcome
from policies.motion.trajectory import Trajectory
from policies.picking.load_check import LoadCheck

_BRAKING = 10  # control steps in which a motion is brought to rest


@dataclass(frozen=True, kw_only=True)
class ExecutionSettings:
    """Times [s] and forces [N] of an attempt."""

    stop_force: float = 60.0  # largest contact force on the approach; beyond it, the approach is broken off
    close_time: float = 0.6  # longest wait for the closing jaw to come to rest
    release_time: float = 0.16  # time in which the jaw opens before the arm leaves
    settle_time: float = 1.5  # longest wait for the released part to be judged
    # whether the next frame is taken as soon as arm and load are out of sight, to be perceived while the arm goes home
    look_ahead: bool = True


class Execution:
    """Steps the environment through one attempt and remembers what its outcome depends on.

    Two methods let a subclass leave out physics: :meth:`place_home` and ``_carry_kinematically``. Here they do nothing.
    """

    def __init__(self, env: BinPickEnv, settings: ExecutionSettings) -> None:
        self._env = env
        self._settings = settings
        self._commanded: list[Floats] = []  # (6,) joint targets so far, for the way back [rad]
        self._collided = self._put_back = False
        self._frame_id = env.frame_id
        self._may_look: Callable[[], bool] | None = None
        self.double = False  # whether the carry ended because more than one part was found in the jaw
        self.emptied = False  # whether the jaw was empty at the last step of the carry
        self.looked_ahead = False  # whether the next frame was taken during the carry or over the tray
        self.retraced = False  # whether the arm went back the way that it came, which leads through the bin
        self._held: dict[str, bool] = {}  # whether both pads touched a part when closed, lifted and carried

    def follow(self, trajectory: Trajectory, gripper: float, *, guard: bool = False) -> bool:
        """Run a trajectory; with ``guard``, stop and return False when the contact force exceeds its limit."""
        for q in trajectory.q[1:]:
            self._step(q, gripper)
            if guard and self._exceeds_force():
                return False
        return True

    def until_force(self, way: Iterable[Floats], gripper: float, force: float) -> bool:
        """Go through (6,) postures [rad] until the contact force reaches ``force`` [N]; return whether it did.

        A posture is asked for when the arm is at the one before it.
        """
        for q in way:
            self._step(q, gripper)
            if self._env.simulation.robot_contact().force >= force:
                return True
        return False

    def place_home(self) -> bool:
        """Put the arm at home without a motion, where possible; return whether it is there. Here it never is."""
        return False

    def carry(
        self, trajectory: Trajectory, empty: float, check: LoadCheck | None = None, *, stop: bool = False
    ) -> bool:
        """Lift and carry with the jaw closing; stop and return False if the jaw is empty after the lift.

        Args:
            trajectory: Motion whose first mark is the end of the lift.
            empty: Gripper position from which the jaw holds nothing, in [0, 1].
            check: Measures the load during the lift; None for no measurement.
            stop: Whether the motion also stops where the check finds more than one part; ``double`` is then True.
        """
        lifted = trajectory.marks[0]
        for k, q in enumerate(trajectory.q[1:], start=1):
            self._step(q, 1.0)
            if check is not None and k <= lifted:
                check.feel()
            if k == lifted:
                self._held["lifted"] = bool(self._env.simulation.gripped())
                if self._env.simulation.gripper_position >= empty:
                    return False
                if check is not None and check.decide() and stop:
                    self.double = True
                    self._brake(trajectory, k)
                    return False
            if k >= lifted and self._carry_kinematically(trajectory, k):
                break
            self.emptied = self._env.simulation.gripper_position >= empty
            if k > lifted and self._may_look is not None and not self.looked_ahead and self._may_look():
                self.look_ahead()
        self._held["carried"] = bool(self._env.simulation.gripped())
        return True

    def put_down(self, trajectory: Trajectory | None, check: LoadCheck) -> None:
        """Lower the load until most of its weight is gone or the trajectory, if any, ends; then let go of it."""
        for q in [] if trajectory is None else trajectory.q[1:]:
            self._step(q, 1.0)
            check.feel()
            if check.lightened():
                break
        self.release()
        self._put_back = True

    def still_double(self, check: LoadCheck) -> bool:
        """Weigh the load once more, at rest; return whether it still is more than one part."""
        for _ in range(check.readings):
            self._step(self._env.simulation.target, 1.0)
            check.feel()
        self.double = check.decide()
        return self.double

    def _brake(self, trajectory: Trajectory, k: int) -> None:
        """Come to rest along the trajectory from its sample ``k`` on."""
        at, last = float(k), len(trajectory.q) - 1
        for n in range(_BRAKING):
            at = min(at + 1.0 - (n + 1) / _BRAKING, float(last))
            low = min(int(at), last - 1)
            self._step(trajectory.q[low] + (at - low) * (trajectory.q[low + 1] - trajectory.q[low]), 1.0)

    def close(self) -> None:
        """Close the jaw and wait until it is at rest."""
        simulation = self._env.simulation
        last = -1.0
        for k in range(round(self._settings.close_time / CONTROL_PERIOD)):
            self._step(simulation.target, 1.0)
            if k >= 3 and abs(simulation.gripper_position - last) < 2e-3:
                break
            last = simulation.gripper_position
        self._held["closed"] = bool(simulation.gripped())

    def look_when(self, may_look: Callable[[], bool]) -> None:
        """Have the next frame taken during the carry, as soon as ``may_look`` returns True after the lift."""
        if self._settings.look_ahead:
            self._may_look = may_look

    def look_ahead(self) -> None:
        """Take the next frame before the arm is home, unless it is there or is to be taken at home.

        A carry that ends at home has led to the frame that is taken there. Where the load was lost, it may lie in the
        bin, or still be moving.
        """
        due = self._env.frame_id == self._frame_id and not self.emptied
        if self._settings.look_ahead and due and not self._env.truncated:
            self._env.look(ahead=True)
            self.looked_ahead = True

    def release(self) -> None:
        """Open the jaw."""
        for _ in range(round(self._settings.release_time / CONTROL_PERIOD)):
            self._step(self._env.simulation.target, 0.0)

    def retrace(self) -> None:
        """Go back through all commanded targets with the jaw open."""
        self.retraced = True
        for q in reversed(self._commanded.copy()):
            self._step(q, 0.0)

    def await_judgement(self) -> None:
        """Wait at rest until no part is left to be judged, so that each counts for the attempt that moved it."""
        for _ in range(round(self._settings.settle_time / CONTROL_PERIOD)):
            if not self._env.unjudged():
                return
            self._step(self._env.simulation.target, 0.0)

    def outcome(self, kinds: list[Delivery]) -> GraspOutcome:
        """Name the outcome from how parts left play during the attempt, and from when a part was held."""
        if Delivery.DELIVERED in kinds:
            return GraspOutcome.DELIVERED
        if Delivery.DOUBLE in kinds:
            return GraspOutcome.DOUBLE
        if Delivery.LEFT_BIN in kinds:
            return GraspOutcome.LEFT_BIN
        if self._put_back:
            return GraspOutcome.PUT_BACK
        if self._collided:
            return GraspOutcome.COLLIDED
        if not self._held.get("closed", False):
            return GraspOutcome.MISSED
        if not self._held.get("lifted", False):
            return GraspOutcome.SLIPPED
        if not self._held.get("carried", False):
            return GraspOutcome.DROPPED
        return GraspOutcome.NOT_SETTLED

    def _exceeds_force(self) -> bool:
        """Return, and remember, whether the contact force exceeds its limit."""
        if self._env.simulation.robot_contact().force <= self._settings.stop_force:
            return False
        self._collided = True
        return True

    def _carry_kinematically(self, trajectory: Trajectory, k: int) -> bool:  # noqa: ARG002 - a subclass uses them
        """Put arm and load from sample ``k`` to the trajectory's end, where possible; return whether they are there."""
        return False

    def _step(self, q: Floats, gripper: float) -> None:
        if self._env.truncated:
            return
        self._commanded.append(self._env.simulation.target.copy())
        self._advance(np.append(q, gripper).astype(np.float32))

    def _advance(self, action: NDArray[np.float32]) -> None:
        self._env.step(action)
