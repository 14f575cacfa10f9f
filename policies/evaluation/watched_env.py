"""The robot cell with a hook after each control step, for films and recordings."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from binpick_env.env import BinPickEnv
from binpick_env.env_spaces import Observation


class StepListener(Protocol):
    """Is called after each control step and changes nothing."""

    def after_step(self, env: BinPickEnv) -> None:
        """Read the state of ``env``, which has just made a step."""
        ...


class WatchedEnv(BinPickEnv):
    """The cell; it calls its listeners after each step."""

    watchers: tuple[StepListener, ...] = ()

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance as :meth:`BinPickEnv.step` does."""
        result = super().step(action)
        for watcher in self.watchers:
            watcher.after_step(self)
        return result

    def watch(self, watcher: StepListener) -> None:
        """Call ``watcher`` after each step from now on."""
        self.watchers = (*self.watchers, watcher)

    def unwatch(self, watcher: StepListener) -> None:
        """Stop calling ``watcher``."""
        self.watchers = tuple(each for each in self.watchers if each is not watcher)
