"""A cache in the user's cache folder for arrays that are slow to compute and determined by their key."""

import hashlib
import logging
import os
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
from numpy.typing import NDArray

_log = logging.getLogger(__name__)
Arrays = Mapping[str, NDArray[Any]]


def cache_folder() -> Path:
    """Return the cache folder: ``$BINPICK_CACHE``, or else the platform's cache folder of this user."""
    return Path(os.environ.get("BINPICK_CACHE") or platformdirs.user_cache_dir("binpick"))


def digest(*contents: object) -> str:
    """Return a sha256 over arrays (shape, dtype and bytes) and the ``repr`` of all other values."""
    total = hashlib.sha256()
    for content in contents:
        if isinstance(content, np.ndarray):
            total.update(f"{content.shape}{content.dtype}".encode() + np.ascontiguousarray(content).tobytes())
        else:
            total.update(repr(content).encode())
        total.update(b"\0")
    return total.hexdigest()


def cached_arrays(kind: str, key: str, compute: Callable[[], Arrays]) -> Arrays:
    """Return the arrays stored for ``kind`` and ``key``, or compute and store them.

    Args:
        kind: Name of what is computed, the first part of the file's name.
        key: Digest of everything that the arrays depend on.
        compute: Returns the arrays by name.

    Note:
        Files are written atomically, so parallel workers never read half a file. Arrays of an unreadable file are
        computed again. If the folder cannot be written, a warning is logged.
    """
    path = cache_folder() / f"{kind}-{key}.npz"
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except FileNotFoundError:
        _log.info("preparing the part: %s, once, kept in %s", kind.replace("_", " ").replace("-", " "), path.parent)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        _log.warning("cannot read %s (%s): computing it anew", path, error)
    arrays = compute()
    try:
        _write(path, arrays)
    except OSError as error:
        _log.warning("cannot write %s: %s", path, error)
    return arrays


def _write(path: Path, arrays: Arrays) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
        unfinished = Path(file.name)
        try:
            np.savez(file, allow_pickle=False, **dict(arrays))
            file.flush()
            unfinished.replace(path)
        except OSError:
            unfinished.unlink(missing_ok=True)
            raise
