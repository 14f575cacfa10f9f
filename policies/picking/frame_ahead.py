"""The frame of the next decision, taken while the load is carried away, and whether the bin still is as it shows it."""

import time

import numpy as np

from binpick_env.env import BinPickEnv
from policies.picking.bin_view import BinView
from policies.picking.execution import Execution
from policies.picking.load_check import LoadCheck
from policies.picking.load_image import bin_changed, image_of, shows_motion

_STREAM = 2  # number of the random stream of the second images; 1 is that of the wrist


class FrameAhead:
    """Takes the next frame as soon as arm and load are out of sight, and takes it again at home where it is outdated.

    A second image follows the frame, when the load has been released. Its exposure passes while the frame is perceived.
    If it shows another bin, parts were still moving, and nothing that the frame led to is executed. Of parts that are
    too thin or too small for that no frame is taken ahead.
    """

    def __init__(self, env: BinPickEnv, cell: float) -> None:
        """Look up the arm's shapes.

        Args:
            env: The unwrapped cell.
            cell: Edge length of a cell of the height maps that are compared [m].
        """
        self._env, self._cell = env, cell
        self._view = BinView(env)
        self._shows_motion = shows_motion(env.part.model)
        self.reset()

    def reset(self) -> None:
        """Begin a bin."""
        self._rng = np.random.default_rng([max(self._env.np_random_seed, 0), _STREAM])  # -1: a given generator
        self._outdated = False

    def watch(self, execution: Execution, check: LoadCheck) -> None:
        """Have an attempt take the frame during its carry.

        Not where an image of the bin has to tell one part from two: the frame would be outdated if they are put back.
        """
        self._outdated = False
        if self._shows_motion:
            execution.look_when(lambda: not check.needs_image and self._view.clear())

    def look(self, execution: Execution) -> None:
        """Take the frame at the end of the carry, if it is not taken yet, and arm and load are out of sight."""
        if self._shows_motion and self._view.clear():
            execution.look_ahead()

    def compare(self, execution: Execution) -> float:
        """See whether anything has moved since the frame; return the wall clock spent on it [s]."""
        if not execution.looked_ahead:
            return 0.0
        image = image_of(self._env, self._rng)
        started = time.perf_counter()
        self._outdated = bin_changed(self._env, image, self._cell)
        return time.perf_counter() - started

    def renew(self, execution: Execution) -> None:
        """Take the frame again, with the arm at home, if the bin is no longer as it shows it."""
        if not execution.looked_ahead or not (execution.retraced or execution.emptied or self._outdated):
            return
        if self._env.episode.away:  # a protective stop holds the arm, perhaps before the camera
            self._env.expect_frame()
        else:
            self._env.look()
