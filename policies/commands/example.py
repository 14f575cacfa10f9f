"""``binpick example``: a small frame with camera, bin and part, to try ``binpick perceive`` on."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from policies.commands.command_line import exit_code, parse


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Copy a small frame with its camera, bin and part into a folder, to try perceive on."""

    # folder that the files are copied to
    out: Annotated[Path, tyro.conf.Positional] = Path("camera_example")


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and copy; return the exit code."""
    return run(parse(Arguments, "example", arguments))


def run(args: Arguments) -> int:
    """Copy the files; return the exit code."""
    return exit_code(lambda: _copy(args.out), (ValueError, OSError))


def _copy(folder: Path) -> str:
    from policies.frames import copy_example, example_files

    copy_example(folder)
    return "\n".join(str(folder / name) for name in example_files())
