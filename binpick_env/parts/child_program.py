"""Work of compiled libraries in a child process: whatever happens there, the caller gets a result or a text."""

import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

_CALL = "import runpy, sys; runpy.run_path(sys.argv[1])['main'](*sys.argv[2:])"


def run_program(program: Path, arguments: Sequence[str], *, what: str, advice: str, timeout: float) -> None:
    """Call ``main`` of a Python file with text arguments in a process of its own.

    Args:
        program: Python file.
        arguments: Arguments of ``main``.
        what: What is done, for the message of an error.
        advice: What to do about an end by a signal, for the message.
        timeout: Time after which it is given up [s].

    Raises:
        ValueError: The process ends by a signal, fails, or takes too long.
    """
    # -P keeps the program's own folder, whose modules have common names, off the search path.
    command = [sys.executable, "-P", "-c", _CALL, str(program), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=timeout)
    except subprocess.TimeoutExpired:
        raise ValueError(f"{what} took more than {timeout:g} s; simplify it first") from None
    if done.returncode < 0:
        raise ValueError(f"{what} ended by signal {signal.Signals(-done.returncode).name}: {advice}")
    if done.returncode != 0:
        raise ValueError(f"{what} failed: {(done.stderr.strip().splitlines() or ['no message'])[-1]}")
