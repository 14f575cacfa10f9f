"""A recording of a bin as an .rrd file for Rerun's viewer: the cell, what the robot sees, and what it does."""

import importlib
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from binpick_env.env import BinPickEnv
from policies.evaluation.listeners import BinListener, Decision

if TYPE_CHECKING:
    from policies.report.recording_scene import SceneLog


class Recording(BinListener):
    """Records every step, frame and decision of one bin; the file appears when it is complete."""

    def __init__(self, path: Path) -> None:
        """Check that the file can be written; it is opened when the bin has settled.

        Args:
            path: Path of the .rrd; its folder is made.

        Raises:
            ValueError: The file cannot be written.
            ModuleNotFoundError: The extra ``viz`` is not installed; the text tells how to install it.
        """
        check_recording(path)
        self._path = path
        self._log: SceneLog | None = None
        self._decisions = 0  # decisions that have begun
        self._decision_start = 0.0  # simulated time at which the last one began [s]
        self._frame_id = -1

    def bin_settled(self, env: BinPickEnv) -> str:
        """Open the file and write the shapes of the cell."""
        scene = importlib.import_module("policies.report.recording_scene")  # needs Rerun, an extra
        self._log = scene.SceneLog(draft_of(self._path), env)
        return ""

    def before_decision(self, env: BinPickEnv) -> None:
        """Record the frame that a decision is about to be made on."""
        self.after_step(env)
        self._decisions += 1
        self._decision_start = env.simulation.time

    def after_step(self, env: BinPickEnv) -> None:
        """Record the state of the cell, and the frame if a new one has been taken."""
        if self._log is None:
            return
        self._log.step()
        if env.frame_id != self._frame_id:
            self._frame_id = env.frame_id
            self._log.frame(self._decisions)

    def after_decision(self, env: BinPickEnv, decision: Decision) -> str:  # noqa: ARG002
        """Record what was decided and how the attempt ended."""
        if self._log is not None:
            self._log.decision(decision.number, self._decision_start, decision.result)
        return ""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._log is None:
            return
        try:
            if error is None:
                self._log.close()
                draft_of(self._path).replace(self._path)
            else:
                self._log.abandon()
        finally:
            draft_of(self._path).unlink(missing_ok=True)
            self._log = None


def check_recording(path: Path) -> None:
    """Raise unless a recording can be written to ``path``, whose folder is made.

    Raises:
        ValueError: The name does not end in .rrd, or no file can be written there.
        ModuleNotFoundError: The extra ``viz`` is not installed; the text tells how.
    """
    if path.suffix != ".rrd":
        raise ValueError(f"a recording's name must end in .rrd, got {str(path)!r}")
    try:
        importlib.import_module("rerun")
    except ImportError as error:
        raise ModuleNotFoundError(
            'a recording needs Rerun: .venv/bin/python -m pip install -e ".[viz]", '
            'or pip install "binpick[viz]" without a checkout'
        ) from error
    if path.is_dir():
        raise ValueError(f"a recording is a file, but {path} is a folder")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        draft_of(path).touch()
        draft_of(path).unlink()
    except OSError as error:
        raise ValueError(f"no recording can be written to {path}: {error.strerror}") from error


def draft_of(path: Path) -> Path:
    """Return the file that a recording is written to until it is complete."""
    return path.with_name(f".{path.stem}.draft.rrd")
