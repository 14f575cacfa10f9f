"""Atomic writes: files and folders are written under another name and then renamed, so no reader sees half of one."""

import glob
import json
import os
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

_STALE = 5.0  # time after which the draft of a process that has ended is left over [s]


def json_text(values: Any, indent: int | None = 1) -> str:
    """Return ``values`` as JSON; NaN, which JSON does not know, becomes null.

    Args:
        values: Dictionaries, lists, tuples, numbers and text.
        indent: Spaces before a nested value; None writes a single line without any space.
    """
    separators = (",", ":") if indent is None else None
    return json.dumps(_without_nan(values), indent=indent, separators=separators, allow_nan=False)


def _without_nan(values: Any) -> Any:
    if isinstance(values, dict):
        return {key: _without_nan(value) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [_without_nan(value) for value in values]
    return None if isinstance(values, float) and np.isnan(values) else values


def write_atomically(path: Path, text: str) -> None:
    """Write ``text`` to ``path`` atomically, in UTF-8; folders that are missing are created.

    A character that UTF-8 does not have, such as those of a file's name in another encoding, becomes a question mark.
    """

    def write(draft: Path) -> None:
        draft.write_text(text, encoding="utf-8", errors="replace")

    replace_atomically(path, write)


def write_bytes_atomically(path: Path, content: bytes) -> None:
    """Write ``content`` to ``path`` atomically; folders that are missing are created."""

    def write(draft: Path) -> None:
        draft.write_bytes(content)

    replace_atomically(path, write)


def replace_atomically(path: Path, write: Callable[[Path], None]) -> None:
    """Replace ``path`` atomically by what ``write`` writes.

    Args:
        path: File to create or replace; folders that are missing are created. Drafts of it that killed processes
            have left are removed.
        write: Writes the file whose path it is given. If it fails, that file is removed and ``path`` stays as it was.

    Raises:
        OSError: The file cannot be written; the error names ``path``.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_left_over(path)
    draft = _draft_of(path)
    try:
        write(draft)
        draft.replace(path)
    except BaseException as error:
        draft.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno and error.filename in (None, str(draft)):
            raise OSError(error.errno, error.strerror, str(path)) from error  # a full disk names no file
        raise


def make_folder_atomically(folder: Path, write: Callable[[Path], None]) -> bool:
    """Make a folder that appears with everything in it.

    Args:
        folder: Folder to make; those around it that are missing are created. Drafts of it that killed processes have
            left are removed.
        write: Writes into the folder whose path it is given, which is empty. If it fails, nothing is left.

    Returns:
        Whether it was made: a folder that another process has made meanwhile stays as it is.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    _remove_left_over(folder)
    draft = _draft_of(folder)
    shutil.rmtree(draft, ignore_errors=True)  # left by a process that had this one's number
    try:
        draft.mkdir()
        write(draft)
        return _renamed(draft, folder)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _renamed(draft: Path, folder: Path) -> bool:
    """Give a draft the name of a folder; tell whether there was none."""
    try:
        draft.rename(folder)
    except OSError:
        if folder.is_dir():
            return False
        raise
    return True


def _draft_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}")


def _remove_left_over(path: Path) -> None:
    """Remove the drafts of a file or a folder whose processes were killed while they wrote."""
    for draft in path.parent.glob(f".{glob.escape(path.name)}.*"):
        pid = draft.suffix[1:]
        # Another machine's process may have any number, but it would still be writing.
        with suppress(OSError):  # a second writer may remove it, too
            if pid.isdecimal() and not _is_running(int(pid)) and time.time() - _last_written(draft) > _STALE:
                shutil.rmtree(draft) if draft.is_dir() else draft.unlink()


def _last_written(draft: Path) -> float:
    return max(path.stat().st_mtime for path in (draft, *draft.rglob("*")))


def _is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # another user's
        return True
    return True
