"""The parent of the fuzz test's child: it keeps one ready, gives it cases, and replaces it when it hangs or dies."""

import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

from policies.soak.fuzz.judge import Verdict

LIMIT = 5.0  # time of a case [s]
READY = 600.0  # time that a child may take to load everything [s]
_DRAWING = 60.0  # time that the drawing of a case may take [s]
_BUSY = 6  # factor of the limit for a child that gets no core, on a busy machine
Program = Callable[[Connection, Path, Path], None]
_TICK = os.sysconf("SC_CLK_TCK")


class ChildKeeper:
    """Keeps one child process that judges cases."""

    def __init__(self, program: Program, folder: Path, limit: float = LIMIT) -> None:
        """Start no child yet.

        Args:
            program: Function that the child runs, such as :func:`policies.soak.fuzz.child.serve`.
            folder: Folder of samples and cache.
            limit: Time that a case may take [s].
        """
        self._program = program
        self._folder = folder
        self._limit = limit
        self._child: BaseProcess | None = None
        self._connection: Connection | None = None

    def run(self, grammar: str, seed: tuple[int, ...]) -> Verdict:
        """Judge one case.

        Raises:
            RuntimeError: No child gets ready.
        """
        child, connection = self._ready()
        try:
            connection.send((grammar, seed))
            if not connection.poll(_DRAWING):
                return self._killed(f"its input was not drawn within {_DRAWING:g} s")
            connection.recv()  # started
            if not self._answered(child, connection):
                return self._killed(f"it took more than {self._limit:g} s")
            verdict: Verdict = connection.recv()
        except (EOFError, ConnectionError):
            return self._killed("")
        return verdict

    def close(self) -> None:
        """End the child."""
        if self._child is not None:
            self._killed("")

    def _ready(self) -> tuple[BaseProcess, Connection]:
        if self._child is not None and self._connection is not None:
            return self._child, self._connection
        context = multiprocessing.get_context("spawn")
        connection, theirs = context.Pipe()
        child = context.Process(target=self._program, args=(theirs, self._folder / "samples", self._folder / "cache"))
        child.start()
        theirs.close()
        self._child, self._connection = child, connection
        try:
            if not connection.poll(READY):
                raise EOFError
            connection.recv()
        except EOFError as error:
            self._killed("")
            log = self._folder / "child.log"
            raise RuntimeError(f"the child process of fuzz did not get ready: see the end of {log}") from error
        return child, connection

    def _answered(self, child: BaseProcess, connection: Connection) -> bool:
        """Wait for an answer; on a busy machine the limit is for the child's own time."""
        started, before = time.monotonic(), _own_time(child)
        for _ in range(_BUSY):
            if connection.poll(self._limit):
                return True
            if _own_time(child) - before > 0.8 * self._limit:
                break
        return time.monotonic() - started < self._limit

    def _killed(self, why: str) -> Verdict:
        """End the child, if it has not ended itself, and say how it ended."""
        child, connection = self._child, self._connection
        assert child is not None
        assert connection is not None
        connection.close()  # which a child that waits for a case takes as the end
        if not why:
            child.join(_DRAWING)
        with suppress(ProcessLookupError):
            os.killpg(child.pid or 0, signal.SIGKILL)
        child.join()
        self._child = self._connection = None
        code = child.exitcode or 0
        ended = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        return Verdict(outcome="failure", text=why or f"the process ended by {ended}")


def _own_time(child: BaseProcess) -> float:
    """Return the processor time of a process and of its ended children [s]."""
    text = Path(f"/proc/{child.pid}/stat").read_text(encoding="utf-8")
    return sum(int(ticks) for ticks in text.rpartition(")")[2].split()[11:15]) / _TICK
