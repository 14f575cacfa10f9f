"""A film of the cell as an mp4, from the environment's own pictures."""

import importlib
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from binpick_env.config import CONTROL_PERIOD
from binpick_env.env import BinPickEnv
from policies.evaluation.listeners import BinListener

EVERY = 4  # steps from picture to picture: 0.16 s
SPEED = 2.0  # simulated seconds shown per second of film, unless given
SPEEDS = (0.25, 20.0)  # range of speeds that players show smoothly


class Film(BinListener):
    """Writes every ``EVERY``-th step's picture of a cell into an mp4; the file appears when the film is complete."""

    def __init__(self, path: Path, limit: float = 60.0, speed: float = SPEED) -> None:
        """Prepare the file.

        Args:
            path: Path of the mp4; its folder is made.
            limit: Largest length of the film in simulated time [s].
            speed: Simulated seconds shown per second of film.

        Raises:
            ValueError: The path does not end in .mp4, or limit or speed has no meaning.
            ModuleNotFoundError: The extra ``report`` is not installed; the text tells how to install it.
        """
        check_video(path, limit, speed)
        self._speed = speed
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path, self._draft = path, path.with_name(f".{path.stem}.draft.mp4")
        self._steps = 0
        self._max_steps = round(limit / CONTROL_PERIOD)
        self._writer: Any = None

    def after_step(self, env: BinPickEnv) -> None:
        """Take a picture after every ``EVERY``-th step, up to the film's limit."""
        due = self._steps % EVERY == 0 and self._steps < self._max_steps
        self._steps += 1
        picture = env.render() if due else None
        if picture is not None:
            self._add(picture)

    def _add(self, picture: NDArray[np.uint8]) -> None:
        """Append an (H, W, 3) uint8 picture; H and W are cut to even numbers, which the codec requires."""
        height, width = picture.shape[0] // 2 * 2, picture.shape[1] // 2 * 2
        if self._writer is None:
            ffmpeg: Any = importlib.import_module("imageio_ffmpeg")  # an extra that nothing else needs
            fps = self._speed / (EVERY * CONTROL_PERIOD)
            self._writer = ffmpeg.write_frames(
                str(self._draft), (width, height), fps=fps, codec="libx264", quality=7, macro_block_size=2
            )
            self._writer.send(None)
        self._writer.send(np.ascontiguousarray(picture[:height, :width]))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._writer is None:
            return
        self._writer.close()
        self._writer = None
        if error is None:
            self._draft.replace(self._path)
        else:
            self._draft.unlink(missing_ok=True)


def check_length(limit: float, speed: float) -> None:
    """Raise ``ValueError`` unless a film may have this limit in simulated time [s], and this speed."""
    if not limit > 0:
        raise ValueError(f"a film's limit must be positive, got {limit:g} s of simulated time")
    if not SPEEDS[0] <= speed <= SPEEDS[1]:
        raise ValueError(
            f"a film's speed must be from {SPEEDS[0]:g} to {SPEEDS[1]:g} times the real one, got {speed:g}"
        )


def check_video(path: Path, limit: float = 60.0, speed: float = SPEED) -> None:
    """Raise unless a film can be written to ``path``.

    Raises:
        ValueError: The name does not end in .mp4, the limit is not positive, or the speed is out of `SPEEDS`.
        ModuleNotFoundError: The extra ``report`` is not installed; the text tells how to install it.
    """
    check_length(limit, speed)
    if path.suffix != ".mp4":
        raise ValueError(f"a film's name must end in .mp4, got {str(path)!r}")
    try:
        importlib.import_module("imageio_ffmpeg")
    except ImportError as error:
        raise ModuleNotFoundError(
            "a film needs imageio-ffmpeg: .venv/bin/python -m pip install -e '.[report]'"
        ) from error
