"""Cells whose environments kill their process once; worker processes import this module."""

import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym

from policies.selection.learning.experience import Cells
from tests.policies.selection.learning.toy_selection import ToySelection


class Dying(gym.Wrapper):  # type: ignore[type-arg]
    """Kills this process after some steps, unless another environment has done so."""

    def __init__(self, env: gym.Env[Any, Any], folder: Path, steps: int) -> None:
        super().__init__(env)
        self._folder, self._steps = folder, steps

    def step(self, action: Any) -> Any:
        result = self.env.step(action)
        self._steps -= 1
        if self._steps == 0:
            try:
                (self._folder / "died").touch(exist_ok=False)
            except FileExistsError:
                return result
            os.kill(os.getpid(), signal.SIGKILL)
        return result


@dataclass(frozen=True, kw_only=True)
class DyingCells(Cells):
    folder: str  # holds a file once a process was killed
    steps: int  # steps until then

    def environment(self) -> Any:
        return Dying(super().environment(), Path(self.folder), self.steps)


@dataclass(frozen=True, kw_only=True)
class DyingToys(DyingCells):
    def environment(self) -> Any:
        return Dying(ToySelection(), Path(self.folder), self.steps)
