"""Atomic writes: a file is written under another name and then renamed, so no reader sees half of it."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


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
    """Write ``text`` to ``path`` atomically; folders that are missing are created."""

    def write(draft: Path) -> None:
        draft.write_text(text, encoding="utf-8")

    replace_atomically(path, write)


def replace_atomically(path: Path, write: Callable[[Path], None]) -> None:
    """Replace ``path`` atomically by what ``write`` writes.

    Args:
        path: File to create or replace; folders that are missing are created.
        write: Writes the file whose path it is given. If it fails, that file is removed and ``path`` stays as it was.

    Raises:
        OSError: The file cannot be written; the error names ``path``.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        write(draft)
        draft.replace(path)
    except BaseException as error:
        draft.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno and error.filename in (None, str(draft)):
            raise OSError(error.errno, error.strerror, str(path)) from error  # a full disk names no file
        raise
