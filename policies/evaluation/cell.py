"""The cell in which bins are picked: an environment with the picker that acts on it."""

import logging
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import NamedTuple

from binpick_env.env import BinPickEnv
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.watched_env import WatchedEnv
from policies.picking.episode import Picker
from policies.picking.scripted import ScriptedPicker

_log = logging.getLogger(__name__)


class Cell(NamedTuple):
    """An environment and the picker that acts on it."""

    env: BinPickEnv
    picker: Picker


CellFactory = Callable[[EvaluationConfig], Cell]


class CellCache(AbstractContextManager["CellCache"]):
    """Keeps the cell of the last configuration: building one takes seconds, and a reset leaves no trace of a bin."""

    def __init__(self, make_cell: CellFactory) -> None:
        """Keep the function that builds cells; nothing is built yet."""
        self._make_cell = make_cell
        self._digest = ""
        self._cell: Cell | None = None

    def cell(self, config: EvaluationConfig) -> Cell:
        """Return the cell for ``config``; it is built unless the last one was for the same configuration."""
        digest = config.digest()
        if self._cell is None or digest != self._digest:
            self.close()
            self._cell, self._digest = self._make_cell(config), digest
        return self._cell

    def close(self) -> None:
        """Close the cell; the next one is built anew."""
        if self._cell is not None:
            self._cell.env.close()
        self._cell = None

    def __exit__(self, *_: object) -> None:
        self.close()


def make_env(config: EvaluationConfig) -> WatchedEnv:
    """Build the environment of ``config``; it computes on one thread, see `perception.runtime.threads`."""
    return WatchedEnv(
        part=config.options().load_part(),
        num_parts=config.num_parts,
        perception=config.perception,
        network=config.network,
        sensor=config.sensor,
        pose_noise=config.pose_noise,
        config=config.cell(),
        render_mode="rgb_array",
        threads=1,
    )


def scripted_cell(config: EvaluationConfig) -> Cell:
    """Build the cell with the scripted picker."""
    _log.info("building the cell; if its kernels are not compiled yet, its first pick takes 30 s longer")
    env = make_env(config)
    return Cell(env, ScriptedPicker(env, config.picker))
