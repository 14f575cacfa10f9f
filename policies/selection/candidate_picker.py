"""What pickers share that choose among grasp candidates, where the scripted picker takes its own first choice."""

import time

from binpick_env.env import BinPickEnv
from policies.picking.scripted import ScriptedPicker
from policies.picking.settings import PickerSettings
from policies.selection.candidate_generator import CandidateGenerator, GraspCandidates


class CandidatePicker:
    """Owns the generator of grasp candidates, and the scripted picker that plans and executes the chosen one."""

    def __init__(self, env: BinPickEnv, picker: ScriptedPicker | None, per_part: int) -> None:
        """Build the generator.

        Args:
            env: Unwrapped cell.
            picker: Picker that ranks, plans and executes; a new one if None.
            per_part: Largest number of candidates on one part.
        """
        self._env = env
        self._picker = picker or ScriptedPicker(env, PickerSettings().attempts_only())
        self._generator = CandidateGenerator(env, self._picker, per_part)
        self._compiled = False

    def reset(self) -> None:
        """Forget the failed attempts of the last bin."""
        self._picker.reset()

    def _timed_candidates(self) -> tuple[GraspCandidates, float]:
        """Return the candidates in the last frame, and the wall clock time of perception and generation [s]."""
        if not self._compiled:  # the kernels' compilation is no part of a decision's time
            self._generator.generate()
            self._compiled = True
        started = time.perf_counter()
        candidates = self._generator.generate()
        return candidates, self._env.perception_time + time.perf_counter() - started
