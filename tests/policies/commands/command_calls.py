"""How the tests call commands as a user does, and options that make them quick."""

import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

from policies.commands import main as entry
from tests.memory import give_back

ROOT = Path(__file__).resolve().parents[3]
TINY = ["--min-parts", "2", "--max-parts", "2", "--width", "640", "--height", "480", "--sensor", "none"]
TINY += ["--perception", "oracle"]


def run(command: str, *arguments: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Call a command as its script does, but in this process, which has loaded the simulator and the kernels."""
    out, err = StringIO(), StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.chdir(cwd)
        patch.setattr(entry, "show_status", lambda: None)  # other tests read the levels of the packages' loggers
        try:
            code = entry.main([command, *arguments])
        except SystemExit as stop:
            code = int(stop.code or 0)
    give_back()
    return subprocess.CompletedProcess([command, *arguments], code, out.getvalue(), err.getvalue())


def run_script(command: str, *arguments: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Call a command by its script, in a process of its own, as a user does."""
    return start([sys.executable, str(script(command)), *arguments], cwd)


def script(command: str) -> Path:
    """Return the script of a command."""
    return ROOT / "scripts" / f"{command.replace('-', '_')}.py"


def start(command: list[str], cwd: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Start a process that finds the packages, and wait for its end."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = os.environ | {"PYTHONPATH": path} | variables
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=600)
