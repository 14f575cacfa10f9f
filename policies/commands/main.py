"""``binpick``: lists the commands, or runs the one that is named."""

import os
import sys
from collections.abc import Sequence
from difflib import get_close_matches
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from io import TextIOWrapper
from itertools import groupby

from policies.commands.registry import COMMANDS
from policies.commands.status import show_status

_CLOSE = 0.5  # similarity from which a command's name is suggested, in [0, 1]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: Name and options of the command; those of this process unless given.

    Returns:
        The exit code: 0, 2 for a mistake of the user, 130 after Ctrl-C.
    """
    name, *options = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    if name in ("-h", "--help"):
        print(overview())
        return 0
    if name == "--version":
        print(_version())
        return 0
    typed = name.replace("_", "-")
    modules = {command.name: command.module for command in COMMANDS}
    if typed not in modules:
        close = get_close_matches(typed, modules, cutoff=_CLOSE)
        hint = f"did you mean {' or '.join(close)}? " if close else ""
        print(f"error: there is no command {name!r}; {hint}`binpick` lists them all", file=sys.stderr)
        return 2
    show_status()
    if isinstance(sys.stdout, TextIOWrapper):  # tables have characters that not every terminal's encoding has
        sys.stdout.reconfigure(errors="replace")
    try:
        try:
            return int(import_module(modules[typed]).main(options))
        finally:  # here, where a reader that has gone can still be told apart; help ends in SystemExit
            sys.stdout.flush()
    except BrokenPipeError:  # as in `binpick pick --help | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the interpreter flushes once more at its end
        return 1
    except KeyboardInterrupt:  # before the command's own work, which says how to resume it
        print("\nstopped", file=sys.stderr)
        return 130


def overview() -> str:
    """Return how ``binpick`` is used, and the commands in groups."""
    lines = ["usage: binpick COMMAND [OPTIONS]", "       binpick COMMAND --help", "       binpick --version"]
    width = max(len(command.name) for command in COMMANDS) + 2
    for group, commands in groupby(COMMANDS, lambda command: command.group):
        lines += ["", group, *(f"  {command.name:{width}}{command.summary}" for command in commands)]
    return "\n".join(lines)


def _version() -> str:
    try:
        return f"binpick {version('binpick')}"
    except PackageNotFoundError:
        return "binpick, not installed as a package"
