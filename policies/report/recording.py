"""A recording of a cell as an .rrd file for Rerun's viewer: what is, what the robot sees, and what it does."""

import importlib
import time
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from binpick_env.env import BinPickEnv
from policies.grasping.outcomes import PickResult
from policies.picking.episode import Picker
from policies.report.video import WatchedEnv

if TYPE_CHECKING:
    from policies.report.recording_scene import SceneLog


class Recording(AbstractContextManager["Recording"]):
    """Records every step, frame and decision of one bin; the file appears when it is whole.

    It reads the cell and changes nothing of it: the bin goes as it would go unrecorded.
    """

    def __init__(self, path: Path | None, env: BinPickEnv) -> None:
        """Begin a recording of ``env``, or none at all without a path.

        Args:
            path: Of the .rrd; its folder is made.
            env: A :class:`WatchedEnv` if there is a path; it may be anywhere in its episode.

        Raises:
            ValueError: The file cannot be written, or the environment cannot be watched.
            ModuleNotFoundError: The extra ``viz`` is not installed; the text tells how.
        """
        self.seconds = 0.0  # wall clock spent on recording while the bin went on
        self._path, self._env = path, env
        self._log: SceneLog | None = None
        self._picks = 0  # decisions that have begun
        self._began = 0.0  # when the last of them did, simulated [s]
        self._frame_id = -1
        if path is None:
            return
        if not isinstance(env, WatchedEnv):
            raise ValueError(f"only a WatchedEnv can be recorded, got {type(env).__name__}")
        check_recording(path)
        scene = importlib.import_module(
            "policies.report.recording_scene"
        )  # needs Rerun, an extra that nothing else needs
        self._log = scene.SceneLog(_draft(path), env)
        env.watch(self)

    def around(self, picker: Picker) -> Picker:
        """Return ``picker``, its decisions recorded."""
        return picker if self._log is None else _RecordedPicker(picker, self)

    def before_pick(self) -> None:
        """Record the frame that a decision is about to be made on."""
        self._look(self._env)
        self._picks += 1
        self._began = self._env.simulation.time

    def after_pick(self, result: PickResult) -> None:
        """Record what was decided and what came of it."""
        began = time.perf_counter()
        if self._log is not None:
            self._log.decision(self._picks - 1, self._began, result)
        self.seconds += time.perf_counter() - began

    def after_step(self, env: BinPickEnv) -> None:
        """Record where everything is, and the frame if one has been taken."""
        self._look(env)

    def _look(self, env: BinPickEnv) -> None:
        began = time.perf_counter()
        if self._log is not None:
            self._log.step()
            if env.frame_id != self._frame_id:
                self._frame_id = env.frame_id
                self._log.frame(self._picks)
        self.seconds += time.perf_counter() - began

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._log is None or self._path is None:
            return
        if isinstance(self._env, WatchedEnv):
            self._env.unwatch(self)  # the next bin is not recorded
        try:
            if error is None:
                self._log.close()
                _draft(self._path).replace(self._path)
            else:
                self._log.abandon()
        finally:
            _draft(self._path).unlink(missing_ok=True)
            self._log = None


class _RecordedPicker:
    """Passes decisions on and has them recorded."""

    def __init__(self, picker: Picker, recording: Recording) -> None:
        self._picker, self._recording = picker, recording

    def reset(self) -> None:
        self._picker.reset()

    def pick(self) -> PickResult:
        self._recording.before_pick()
        result = self._picker.pick()
        self._recording.after_pick(result)
        return result


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
        _draft(path).touch()
        _draft(path).unlink()
    except OSError as error:
        raise ValueError(f"no recording can be written to {path}: {error.strerror}") from error


def _draft(path: Path) -> Path:
    return path.with_name(f".{path.stem}.draft.rrd")
