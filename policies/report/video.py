"""A film of the cell as an mp4, from the environment's own pictures."""

import importlib
import time
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from binpick_env.config import CONTROL_PERIOD
from binpick_env.env import BinPickEnv, Observation

EVERY = 4  # steps from picture to picture: 0.16 s
SPEED = 2.0  # of the film against simulated time


class Watcher(Protocol):
    """Looks at a cell after each step and changes nothing."""

    def after_step(self, env: BinPickEnv) -> None:
        """Look at ``env``, which has just made a step."""
        ...


class WatchedEnv(BinPickEnv):
    """The cell with a camera team: after each step all who watch it may look."""

    watchers: tuple[Watcher, ...] = ()

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance as :meth:`BinPickEnv.step` does."""
        result = super().step(action)
        for watcher in self.watchers:
            watcher.after_step(self)
        return result

    def watch(self, watcher: Watcher) -> None:
        """Let ``watcher`` look after each step from now on."""
        self.watchers = (*self.watchers, watcher)

    def unwatch(self, watcher: Watcher) -> None:
        """Let ``watcher`` look no more."""
        self.watchers = tuple(each for each in self.watchers if each is not watcher)


class Film(AbstractContextManager["Film"]):
    """Writes every ``EVERY``-th step's picture of a cell into an mp4; the file appears when the film is whole."""

    def __init__(self, path: Path | None, limit: float = 60.0) -> None:
        """Prepare the file, or nothing at all for None.

        Args:
            path: Of the mp4; its folder is made.
            limit: Length in simulated time [s].

        Raises:
            ValueError: The path does not end in .mp4.
            ModuleNotFoundError: The extra ``report`` is not installed; the text tells how.
        """
        self.seconds = 0.0  # wall clock spent on pictures
        self._steps = 0
        self._max_steps = round(limit / CONTROL_PERIOD)
        self._writer: Any = None
        self._env: WatchedEnv | None = None
        self._path = path
        if path is not None:
            check_video(path)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._draft = path.with_name(f".{path.stem}.draft.mp4")

    @classmethod
    def into(cls, path: Path | None, env: BinPickEnv, limit: float = 60.0) -> "Film":
        """Film ``env`` into ``path``; without a path nothing is filmed."""
        film = cls(path, limit)
        if path is not None:
            if not isinstance(env, WatchedEnv):
                raise ValueError(f"only a WatchedEnv can be filmed, got {type(env).__name__}")
            env.watch(film)
            film._env = env
        return film

    def after_step(self, env: BinPickEnv) -> None:
        """Take a picture if it is time for one."""
        due = self._steps % EVERY == 0 and self._steps < self._max_steps
        self._steps += 1
        if due:
            start = time.perf_counter()
            picture = env.render()
            if picture is not None:
                self.add(picture)
            self.seconds += time.perf_counter() - start

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Append an (H, W, 3) uint8 picture; H and W are cut to even numbers, as the codec wants."""
        if self._path is None:
            return
        height, width = picture.shape[0] // 2 * 2, picture.shape[1] // 2 * 2
        if self._writer is None:
            ffmpeg: Any = importlib.import_module("imageio_ffmpeg")  # an extra that nothing else needs
            fps = SPEED / (EVERY * CONTROL_PERIOD)
            self._writer = ffmpeg.write_frames(
                str(self._draft), (width, height), fps=fps, codec="libx264", quality=7, macro_block_size=2
            )
            self._writer.send(None)
        self._writer.send(np.ascontiguousarray(picture[:height, :width]))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._env is not None:
            self._env.unwatch(self)  # the next bin is not filmed
        if self._writer is None or self._path is None:
            return
        self._writer.close()
        self._writer = None
        if error is None:
            self._draft.replace(self._path)
        else:
            self._draft.unlink(missing_ok=True)


def check_video(path: Path) -> None:
    """Raise unless a film can be written to ``path``: ValueError for its name, ModuleNotFoundError for the extra."""
    if path.suffix != ".mp4":
        raise ValueError(f"a film's name must end in .mp4, got {str(path)!r}")
    try:
        importlib.import_module("imageio_ffmpeg")
    except ImportError as error:
        raise ModuleNotFoundError(
            "a film needs imageio-ffmpeg: .venv/bin/python -m pip install -e '.[report]'"
        ) from error
