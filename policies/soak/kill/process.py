"""Processes that run a command of binpick, which can be killed with all that they have started."""

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[3]
# By name, since nothing imports a command.
_PROGRAM = "import sys; from policies.commands.main import main; sys.exit(main(sys.argv[1:]))"
_POLL = 0.02  # time between two looks at a folder [s]
LONGEST = 900.0  # time after which a job counts as hung [s]


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a process ended.

    Attributes:
        code: Exit code, negative for a signal; None if it was killed because it hung.
        log: What it printed.
    """

    code: int | None
    log: str

    def complaint(self) -> str:
        """Return why the end is not one that a command may have; empty if it is one."""
        if self.code is None:
            return f"it did not end within {LONGEST:g} s"
        if "Traceback" in self.log or self.code not in (0, 2):
            last = (self.log.strip().splitlines() or ["nothing printed"])[-1]
            return f"it ended with code {self.code}: {last[:300]}"
        return ""


class JobProcess:
    """A started command."""

    def __init__(self, words: Sequence[str], log: Path, cache: Path, largest_file: int | None = None) -> None:
        """Start a command.

        Args:
            words: Words after ``binpick``.
            log: File for what it prints.
            cache: Cache folder of the packages.
            largest_file: Size beyond which it can write no file [bytes]; None for no limit.
        """
        paths = os.pathsep.join(filter(None, [str(_ROOT), os.environ.get("PYTHONPATH")]))
        environment = os.environ | {"PYTHONPATH": paths, "BINPICK_CACHE": str(cache)}
        environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
        self._log = log
        with log.open("wb") as file:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _PROGRAM, *words],
                stdout=file,
                stderr=subprocess.STDOUT,
                env=environment,
                start_new_session=True,
            )
        if largest_file is not None:
            resource.prlimit(self._process.pid, resource.RLIMIT_FSIZE, (largest_file, largest_file))

    def wait(self) -> Ended:
        """Wait for the end."""
        try:
            code: int | None = self._process.wait(LONGEST)
        except subprocess.TimeoutExpired:
            self.kill()
            code = None
        return Ended(code=code, log=self._log.read_text(encoding="utf-8", errors="replace"))

    def kill_after(self, seconds: float, folder: Path | None) -> bool:
        """Kill it, with all that it has started, and return whether it was still running.

        Args:
            seconds: Time until then [s].
            folder: Folder from whose first file on the time counts; None counts from now on.
        """
        while folder is not None and self._process.poll() is None and not _has_files(folder):
            time.sleep(_POLL)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(seconds)
        running = self._process.poll() is None
        self.kill()
        return running

    def kill(self) -> None:
        """Kill it, with all that it has started."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


def _has_files(folder: Path) -> bool:
    return folder.is_dir() and any(path.is_file() for path in folder.rglob("*"))
