"""Compiles the kernels that most tests use: `python -m tests.compiled_kernels`.

A process that compiles a kernel keeps what the compiler needed, 300 MB for all of them, and two processes that start
together compile the same ones. Test processes that load kernels from the cache stay small.
"""

import sys
import tempfile
from pathlib import Path

from policies.commands.main import main


def compile_kernels(folder: Path) -> int:
    """Pick the parts of a small bin from pixels; return the exit status of the command."""
    arguments = ["--bins", "1", "--min-parts", "3", "--max-parts", "3", "--no-html", "--out", str(folder)]
    return main(["pick", "--part", "tee", *arguments])


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        sys.exit(compile_kernels(Path(made)))
