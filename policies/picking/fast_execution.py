"""An attempt without physics where the physics cannot matter: on free ways, and at rest."""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from binpick_env.camera.shading import Light
from binpick_env.cell.kinematic_motion import KinematicMotion
from binpick_env.cell.robot import HOME
from binpick_env.config import CONTROL_PERIOD
from binpick_env.env import BinPickEnv
from policies.motion.trajectory import Trajectory
from policies.picking.execution import Execution, ExecutionSettings
from policies.picking.scripted import ScriptedPicker
from policies.picking.settings import PickerSettings

_MARGIN = 3  # control steps before the first contact from which the physics are simulated
_SETTLE = 2  # control steps in which a load that was carried without physics comes to rest in the jaw
_REST_TIME = 2.0  # longest wait for the pile to fall asleep before the next frame [s]


class FastExecution(Execution):
    """Makes the attempt as its parent does, but moves the arm kinematically wherever it touches nothing.

    - The straight approach is checked for contact at every control step, with the true shapes, and simulated from just
      before the first one.
    - Closing, lifting and releasing are always simulated, and so is every motion that touches something.
    - A part that hangs alone and free in the jaw is carried across as it hangs. A part that would slip out on the way
      does not.
    - The way home is left out once the jaw is free.
    - The next frame is taken when the pile is asleep.
    """

    def __init__(
        self, env: BinPickEnv, settings: ExecutionSettings, motion: KinematicMotion, *, next_frame: bool = True
    ) -> None:
        """Prepare one attempt.

        Args:
            env: The unwrapped cell.
            settings: Times and forces.
            motion: Kinematic motion of this cell, which is made once and serves all attempts.
            next_frame: Whether a frame is taken at the end.
        """
        super().__init__(env, settings)
        self._motion, self._next_frame = motion, next_frame

    def follow(self, trajectory: Trajectory, gripper: float, *, guard: bool = False) -> bool:
        """Run a trajectory as the parent does, with the physics from just before the first contact on."""
        q, k, kinematic = trajectory.q, 1, True  # only once: what ends a kinematic motion stays near
        while k < len(q):
            if kinematic and not self._motion.touches() and (k > trajectory.marks[0] or self._pile_sleeps()):
                k = self._move_kinematically(trajectory, k, gripper)
                kinematic = False
                continue
            self._step(q[k], gripper)
            if guard and self._exceeds_force():
                return False
            k += 1
        return True

    def place_home(self) -> bool:
        """Put the arm at home, unless it touches something; return whether it is there."""
        if self._motion.touches():
            return False
        self._motion.place(HOME, HOME, 0.0)
        return True

    def look_when(self, may_look: Callable[[], bool]) -> None:
        """Take no frame during the carry."""

    def look_ahead(self) -> None:
        """Take no frame; it is taken when the pile is asleep."""

    def await_judgement(self) -> None:
        """Wait until every part is judged and the pile is asleep, then take the next frame."""
        super().await_judgement()
        for _ in range(round(_REST_TIME / CONTROL_PERIOD)):
            if self._pile_sleeps():
                break
            self._step(self._env.simulation.target, 0.0)
        if self._next_frame and self._env.remaining > 0:
            self._env.look()

    def _carry_kinematically(self, trajectory: Trajectory, k: int) -> bool:
        part = self._motion.lone_load()
        if part is None:
            return False
        self._motion.carry(part, trajectory.q[-1])
        self._env.skip(len(trajectory.q) - 1 - k)
        for _ in range(_SETTLE):
            self._step(trajectory.q[-1], 1.0)
        return True

    def _move_kinematically(self, trajectory: Trajectory, k: int, gripper: float) -> int:
        """Move without physics from sample k - 1 until a margin before contact; return the next sample to step to."""
        q = trajectory.q
        first = max(k, trajectory.marks[-2])  # until there the trajectory is planned well above the pile
        reached = k - 1
        for j in range(first, len(q)):
            self._motion.place(q[j - 1], q[j], gripper)
            if self._motion.touches():
                reached = max(reached - _MARGIN, k - 1)
                break
            reached = j
        self._motion.place(q[max(reached - 1, 0)], q[reached], gripper)
        self._commanded.extend(q[k - 1 : reached])
        self._env.skip(reached + 1 - k)
        return reached + 1

    def _pile_sleeps(self) -> bool:
        simulation = self._env.simulation
        return bool(simulation.asleep()[simulation.in_play].all())

    def _advance(self, action: NDArray[np.float32]) -> None:
        self._env.advance(action)


def fast_pickers(
    env: BinPickEnv, settings: PickerSettings | None, perception: str
) -> tuple[ScriptedPicker, ScriptedPicker]:
    """Return the scripted picker with fast execution, and set the cell up to compute nothing that is not used.

    Args:
        env: The unwrapped cell.
        settings: Ranking, planning and execution; the defaults if None.
        perception: Perception mode of the cell. With ``"oracle"`` the grey image has no shadows, which take a third of
            a frame's time.

    Returns:
        The picker, and one for attempts that will be undone: it takes no frame after them.
    """
    if perception == "oracle":
        env.light = Light(occlusion=0.0)
    motion = KinematicMotion(env.simulation)
    picker = ScriptedPicker(env, settings, partial(FastExecution, motion=motion))
    return picker, picker.with_execution(partial(FastExecution, motion=motion, next_frame=False))
