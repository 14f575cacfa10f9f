"""What every command shares: how its options are read, and which exit code it ends with."""

import re
import sys
from collections.abc import Callable, Sequence
from decimal import Decimal, InvalidOperation
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
    typed = sys.argv[1:] if arguments is None else arguments
    return tyro.cli(options, args=_as_now(typed), prog=f"binpick {command}")


def _as_now(arguments: Sequence[str]) -> list[str]:
    """Return arguments with the bin's size in metres, and options of the previous version under their present names."""
    now: list[str] = []
    words = iter(arguments)
    for word in words:
        name, given, value = word.partition("=")
        if name in ("--hand-eye", "--hand_eye"):  # taken until the next minor version
            value = value if given else next(words, "")
            print("note: --hand-eye (in metres) is now --hand-eye-mm (in millimetres)", file=sys.stderr)
            now += ["--hand-eye-mm", _times(value, 1000)]
        elif name == "--bin":
            now += [name, *_sides(value if given else next(words, ""))]
        else:
            now.append(word)
    return now


def _sides(size: str) -> list[str]:
    """Return the sides of a bin [m], given as one word in mm; another word stays as it is."""
    return [_times(side, 0.001) for side in size.split("x")] if re.fullmatch(r"[\d.]+x[\d.]+x[\d.]+", size) else [size]


def _times(number: str, factor: float) -> str:
    """Multiply a decimal number exactly; what is none stays as it is."""
    try:
        return str(Decimal(number) * Decimal(str(factor)))
    except InvalidOperation:
        return number


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
