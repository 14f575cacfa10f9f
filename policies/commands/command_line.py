"""What every command shares: how its options are read, and which exit code it ends with."""

import sys
from collections.abc import Callable, Sequence
from typing import Any

import tyro

Errors = tuple[type[Exception], ...]


def parse(options: Any, command: str, arguments: Sequence[str] | None) -> Any:
    """Read a command's options.

    Args:
        options: Dataclass with a field for each option, or a union of those of the subcommands.
        command: Name of the command.
        arguments: What was typed after the name.

    Raises:
        SystemExit: Help was asked for (code 0), or an option is unknown or unusable (code 2); it is printed.
    """
    return tyro.cli(options, args=arguments, prog=f"binpick {command}")


def exit_code(work: Callable[[], str | None], errors: Errors, stopped: str = "stopped") -> int:
    """Do a command's work and return its exit code: 0, 2 for an expected error, 130 for Ctrl-C.

    Args:
        work: Returns the text to print at the end, or None.
        errors: Exceptions whose text tells the user enough; they become one line on stderr.
        stopped: Line for Ctrl-C.
    """
    try:
        text = work()
    except KeyboardInterrupt:
        print(f"\n{stopped}", file=sys.stderr)
        return 130
    except errors as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if text is not None:
        print(text)
    return 0
