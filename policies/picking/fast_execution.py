"""An attempt with the physics left out where nothing can come of it: on free ways, and at rest."""

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
from policies.picking.scripted import PickerSettings, ScriptedPicker

_MARGIN = 3  # control steps before the first touch from which the physics run
_FIRM = 2  # control steps in which a load that was carried without physics comes to rest in the jaw
_REST_TIME = 2.0  # that the pile gets to fall asleep before the next frame, at most [s]


class FastExecution(Execution):
    """Makes the attempt as its parent does, but the arm glides wherever it touches nothing.

    The straight way in is checked for touch at every control step, with the true shapes, and simulated from just
    before the first. Closing, lifting and releasing are always simulated, and so is every motion that touches
    something. A part that hangs alone and free in the jaw is carried across as it hangs: what would slip out on the way
    does not. The way home is left out once the jaw is free, and the next frame is taken when the pile sleeps.
    """

    def __init__(
        self, env: BinPickEnv, settings: ExecutionSettings, glide: KinematicMotion, *, looks: bool = True
    ) -> None:
        """Use ``glide``, which is made once for an environment; without ``looks`` no frame is taken at the end."""
        super().__init__(env, settings)
        self._glide, self._looks = glide, looks

    def follow(self, trajectory: Trajectory, gripper: float, *, guard: bool = False) -> bool:
        """Run a trajectory as the parent does, with the physics from just before the first touch on."""
        q, k, glides = trajectory.q, 1, True  # once: what stops a glide stays near
        while k < len(q):
            if glides and not self._glide.touches() and (k > trajectory.marks[0] or self._pile_sleeps()):
                k = self._glide_on(trajectory, k, gripper)
                glides = False
                continue
            self._step(q[k], gripper)
            if guard and self._pushes():
                return False
            k += 1
        return True

    def leap_home(self) -> bool:
        """Be at home, unless something is touched."""
        if self._glide.touches():
            return False
        self._glide.place(HOME, HOME, 0.0)
        return True

    def await_judgement(self) -> None:
        """Wait until every part is judged and the pile sleeps, then take the next frame."""
        super().await_judgement()
        for _ in range(round(_REST_TIME / CONTROL_PERIOD)):
            if self._pile_sleeps():
                break
            self._step(self._env.simulation.target, 0.0)
        if self._looks and self._env.remaining > 0:
            self._env.look()

    def _carry_across(self, trajectory: Trajectory, k: int) -> bool:
        part = self._glide.lone_load()
        if part is None:
            return False
        self._glide.carry(part, trajectory.q[-1])
        self._env.skip(len(trajectory.q) - 1 - k)
        for _ in range(_FIRM):
            self._step(trajectory.q[-1], 1.0)
        return True

    def _glide_on(self, trajectory: Trajectory, k: int, gripper: float) -> int:
        """Move kinematically from sample k - 1 until a margin before contact; return the sample to go on with."""
        q = trajectory.q
        first = max(k, trajectory.marks[-2])  # planned well above the pile until there
        back = k - 1
        for j in range(first, len(q)):
            self._glide.place(q[j - 1], q[j], gripper)
            if self._glide.touches():
                back = max(back - _MARGIN, k - 1)
                break
            back = j
        self._glide.place(q[max(back - 1, 0)], q[back], gripper)
        self._way.extend(q[k - 1 : back])
        self._env.skip(back + 1 - k)
        return back + 1

    def _pile_sleeps(self) -> bool:
        simulation = self._env.simulation
        return bool(simulation.asleep()[simulation.in_play].all())

    def _advance(self, action: NDArray[np.float32]) -> None:
        self._env.advance(action)


def fast_pickers(
    env: BinPickEnv, settings: PickerSettings | None, perception: str
) -> tuple[ScriptedPicker, ScriptedPicker]:
    """Build the scripted picker that executes fast, and spare the cell what nobody looks at.

    Args:
        env: The unwrapped cell.
        settings: Of the picker, defaults if None.
        perception: The cell's; the oracle does without the grey image's shadows, a third of a frame's time.

    Returns:
        The picker, and one for attempts that will be undone: it takes no frame after them.
    """
    if perception == "oracle":
        env.light = Light(occlusion=0.0)
    glide = KinematicMotion(env.simulation)
    picker = ScriptedPicker(env, settings, partial(FastExecution, glide=glide))
    return picker, picker.executing(partial(FastExecution, glide=glide, looks=False))
