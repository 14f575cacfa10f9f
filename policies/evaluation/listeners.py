"""What follows a bin while it is picked: pictures, films and recordings, for example.

The evaluation knows only the interface. A listener reads the cell and must not change it; the time that it takes is
left out of the bin's wall clock.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Protocol

from binpick_env.env import BinPickEnv
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates
from policies.evaluation.frame_record import FrameRecord
from policies.evaluation.watched_env import WatchedEnv
from policies.grasping.outcomes import PickResult


@dataclass(frozen=True, eq=False, kw_only=True)
class Decision:
    """One decision of the picker, with the frame that it was made on.

    Attributes:
        number: Number of the decision in its bin, from 0.
        labelled_capture: The frame with its ground truth.
        observed: What perception found in the frame.
        frame_record: The frame's candidates and segments compared with the ground truth.
        result: What the picker decided, and how the attempt ended.
    """

    number: int
    labelled_capture: LabelledCapture
    observed: ObservedCandidates
    frame_record: FrameRecord
    result: PickResult


class BinListener(AbstractContextManager["BinListener"]):
    """Follows one bin while it is picked. No method does anything here: a listener overrides those that it needs.

    A listener is a context manager: it is entered before the bin is reset, and exited when the bin has ended or failed.
    """

    def bin_settled(self, env: BinPickEnv) -> str:  # noqa: ARG002
        """Called when the parts lie at rest and the first frame is taken.

        Returns:
            File name of a picture of the bin, "" if none was written.
        """
        return ""

    def before_decision(self, env: BinPickEnv) -> None:
        """Called before each decision, when its frame is taken."""

    def after_step(self, env: BinPickEnv) -> None:
        """Called after each control step."""

    def after_decision(self, env: BinPickEnv, decision: Decision) -> str:  # noqa: ARG002
        """Called after each decision, when it is carried out.

        Returns:
            File name of a picture of the decision, "" if none was written.
        """
        return ""

    def bin_ended(self, env: BinPickEnv) -> str:  # noqa: ARG002
        """Called after the last decision; not called if the bin failed.

        Returns:
            File name of a picture of the bin, "" if none was written.
        """
        return ""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close what is open; ``error`` is the exception that the bin failed with."""


class ListenerFactory(Protocol):
    """Makes the listeners of each bin, in the process that picks it: an instance must be picklable."""

    def listeners(self, index: int, folder: Path) -> Sequence[BinListener]:
        """Return new listeners for bin ``index``, whose record is kept in ``folder``."""
        ...

    def needs_bin(self, index: int) -> bool:
        """Return whether bin ``index`` must be picked even if its record exists already."""
        ...


class ListenerGroup(AbstractContextManager["ListenerGroup"]):
    """Calls all listeners of a bin, in order, and measures the time that they take."""

    def __init__(self, env: BinPickEnv, listeners: Sequence[BinListener]) -> None:
        """Keep the listeners; they are entered with the group.

        Args:
            env: The environment that the bin is picked in.
            listeners: Any number of listeners.

        Raises:
            ValueError: There are listeners, and the environment does not report its steps.
        """
        if listeners and not isinstance(env, WatchedEnv):
            raise ValueError(f"only a WatchedEnv reports its steps to listeners, got {type(env).__name__}")
        self.seconds = 0.0  # wall clock that listeners took while the bin was picked
        self._env = env
        self._listeners = tuple(listeners)
        self._stack = ExitStack()

    def bin_settled(self) -> str:
        """Return the name of the first picture that a listener wrote of the settled bin, "" without any."""
        with self._timed():
            return _first([each.bin_settled(self._env) for each in self._listeners])

    def before_decision(self) -> None:
        """Announce a decision."""
        with self._timed():
            for each in self._listeners:
                each.before_decision(self._env)

    def after_step(self, env: BinPickEnv) -> None:
        """Announce a control step of ``env``."""
        with self._timed():
            for each in self._listeners:
                each.after_step(env)

    def after_decision(self, decision: Decision) -> str:
        """Return the name of the first picture that a listener wrote of ``decision``, "" without any."""
        with self._timed():
            return _first([each.after_decision(self._env, decision) for each in self._listeners])

    def bin_ended(self) -> str:
        """Return the name of the first picture that a listener wrote of the bin's end, "" without any."""
        with self._timed():
            return _first([each.bin_ended(self._env) for each in self._listeners])

    @contextmanager
    def _timed(self) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds += time.perf_counter() - start

    def __enter__(self) -> "ListenerGroup":
        with ExitStack() as stack:
            for each in self._listeners:
                stack.enter_context(each)
            if self._listeners and isinstance(self._env, WatchedEnv):
                self._env.watch(self)
                stack.callback(self._env.unwatch, self)  # the next bin has listeners of its own
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, traceback)


def _first(names: Sequence[str]) -> str:
    return next((name for name in names if name), "")
