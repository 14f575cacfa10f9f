"""What every command shares: how its options are read, and which exit code it ends with."""

import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from decimal import Decimal, InvalidOperation
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, get_args

import tyro

Errors = tuple[type[Exception], ...]
_FILES = ("json", "html", "save", "video", "rerun", "bop")  # options that name a file to be written
_PAGE = 4096  # bytes that are written to see whether a disk is full
_FOLDERS = ("out", "overlay")  # options that name a folder to be written into; those in a command's FILES name a file


def parse(options: Any, command: str, arguments: Sequence[str] | None) -> Any:
    """Read a command's options.

    Args:
        options: Dataclass with a field for each option, or a union of those of the subcommands.
        command: Name of the command.
        arguments: What was typed after the name.

    Raises:
        SystemExit: Help was asked for (code 0), or an option is unknown or unusable (code 2), such as a file that
            cannot be written; it is printed.
    """
    typed = sys.argv[1:] if arguments is None else arguments
    read = tyro.cli(options, args=_as_now(typed), prog=f"binpick {command}")
    for mistake in _unwritable(read):
        print(f"error: {mistake}", file=sys.stderr)
        raise SystemExit(2)
    return read


def _unwritable(options: Any) -> Iterator[str]:
    """Yield what is wrong with the files and folders that a command is to write, before it works for hours."""
    for field in fields(options):
        path = getattr(options, field.name)
        if not isinstance(path, Path) or field.name not in _FILES + _FOLDERS:
            continue
        is_positional = tyro.conf.Positional in get_args(field.type)
        option = "the argument" if is_positional else f"--{field.name.replace('_', '-')}"
        is_folder = field.name in _FOLDERS and field.name not in getattr(options, "FILES", ())
        # Path.exists raises below a folder that cannot be entered, and so does Path.is_dir.
        there = next(each for each in (path, *path.absolute().parents) if os.path.exists(each))  # noqa: PTH110
        if there != path and not there.is_dir():
            yield f"{option} {path} cannot be written: {there} is a file, and no folder"
        elif there == path and path.is_dir() and not is_folder:
            yield f"{option} must name a file, got the folder {path}"
        elif there == path and path.is_file() and is_folder:
            yield f"{option} must name a folder, got the file {path}"
        elif there == path and not (path.is_file() or path.is_dir()):  # the atomic write would put a file in its place
            kind = "folder" if is_folder else "file"
            yield f"{option} must name a {kind}, got {path}, which is a device, a pipe or a socket"
        elif not os.access(there, os.W_OK):
            yield f"{option} {path} cannot be written: {there} is read-only"
        else:
            folder = there if there.is_dir() else there.parent  # an old file is replaced by one beside it
            if (reason := _refusal(folder)) is not None:
                yield f"{option} {path} cannot be written: {folder}: {reason}; name another place, or make room"


def _refusal(folder: Path) -> str | None:
    """Return why no file can be written into a folder, such as one of a full disk; None if one can."""
    try:
        with TemporaryFile(dir=folder) as file:
            file.write(bytes(_PAGE))
    except OSError as error:
        return error.strerror or str(error)
    return None


def _as_now(arguments: Sequence[str]) -> list[str]:
    """Return arguments with the bin's size in metres, a grid as two words, and older options under present names."""
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
        elif name == "--grid":
            value = value if given else next(words, "")
            now += [name, *(value.split("x") if re.fullmatch(r"\d+x\d+", value) else [value])]
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
    except BrokenPipeError:  # an OSError, but nobody's mistake: whoever reads the output has gone
        raise
    except errors as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if text is not None:
        print(text)
    return 0
