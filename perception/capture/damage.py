"""Damaged files: whatever a decoder raises becomes one error that names the file."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np


def require_file(path: Path, what: str = "frame") -> None:
    """Check that a path is a file.

    Args:
        path: Path of the file.
        what: What it should hold, for messages.

    Raises:
        FileNotFoundError: There is nothing, or a link to nothing.
        IsADirectoryError: It is a folder.
    """
    if path.is_dir():
        recording = ", or the folder of a ROS 2 bag with its metadata.yaml" if what == "frame" else ""
        raise IsADirectoryError(
            f"a {what} must be a file{recording}, got the folder {path}: name the files in it"
            + (" (--frames FOLDER on the command line)" if what == "frame" else "")
        )
    if path.is_symlink() and not path.exists():
        raise FileNotFoundError(f"a {what} must be a file, got {path}, a link to {path.readlink()}, which is missing")
    if not path.exists():
        raise FileNotFoundError(f"there is no {what} {path}")


@contextmanager
def decoding(path: Path) -> Iterator[None]:
    """Turn what goes wrong while a file is decoded into a ``ValueError`` that names it.

    Decoders of damaged bytes raise almost anything: missing keys, indices out of range, numbers that are none, errors
    of the zip format. An error that says what must be is kept. What the system says of the file itself (it is missing,
    or must not be read) is passed on.

    Args:
        path: File that is decoded.

    Raises:
        ValueError: The file cannot be decoded.
    """
    try:
        with np.errstate(all="ignore"):
            yield
    except Exception as error:
        if isinstance(error, OSError) and (error.filename is not None or error.errno is None):
            raise  # the system says it of the file itself; where damaged bytes lead a decoder astray, it names no file
        if isinstance(error, ValueError) and path.name in str(error):
            raise
        if isinstance(error, ValueError) and " must " in str(error):
            raise ValueError(f"{path.name}: {error}") from error
        said = f" of the format that {path.suffix} says" if path.suffix and not path.is_dir() else ""
        advice = "correct it there, " if isinstance(error, json.JSONDecodeError) else ""
        raise ValueError(
            f"{path.name} must be a complete {'recording' if path.is_dir() else 'file'}{said}, but cannot be read "
            f"({type(error).__name__}: {error}): {advice}copy it again, or save it anew"
        ) from error
