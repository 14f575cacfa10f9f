"""Files that are whole or absent: written beside their place and renamed."""

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
    """Write ``text`` to ``path`` so that no reader, and no crash, ever meets half of it."""

    def write(draft: Path) -> None:
        draft.write_text(text)

    replace_atomically(path, write)


def replace_atomically(path: Path, write: Callable[[Path], None]) -> None:
    """Let ``write`` fill a draft beside ``path`` and rename it; a draft that fails, on a full disk say, is removed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        write(draft)
        draft.replace(path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
