"""What pickers share that take from the menu of grasps where the scripted picker takes its own first choice."""

import time

from binpick_env.env import BinPickEnv
from policies.picking.scripted import ScriptedPicker
from policies.selection.candidate_generator import CandidateGenerator, GraspCandidates


class CandidatePicker:
    """Holds the cell, the menu, and the scripted picker that plans and executes what is chosen."""

    def __init__(self, env: BinPickEnv, picker: ScriptedPicker | None, per_part: int) -> None:
        """Keep the unwrapped cell, a picker (a new one if None), and how many grasps of each part are offered."""
        self._env = env
        self._picker = picker or ScriptedPicker(env)
        self._menu = CandidateGenerator(env, self._picker, per_part)
        self._compiled = False

    def reset(self) -> None:
        """Forget the last bin."""
        self._picker.reset()

    def _offer(self) -> tuple[GraspCandidates, float]:
        """Return what the last frame offers, and the wall clock that perception and offer took [s]."""
        if not self._compiled:  # the kernels' compilation is no part of a decision's time
            self._menu.offer()
            self._compiled = True
        started = time.perf_counter()
        offer = self._menu.offer()
        return offer, self._env.perception_time + time.perf_counter() - started
