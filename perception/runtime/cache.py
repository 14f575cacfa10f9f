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

from perception.runtime.kernel_cache import first_writable, temporary_folders

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
        computed again. Where the user's cache folder cannot be written, they are kept in a temporary folder of this
        user. If that fails, too, or ``$BINPICK_CACHE`` cannot be written, a warning is logged.
    """
    name = f"{kind}-{key}.npz"
    folders = _folders()
    for folder in folders:
        try:
            with (folder / name).open("rb") as file, np.load(file, allow_pickle=False) as stored:
                return {name: stored[name] for name in stored.files}
        except (FileNotFoundError, NotADirectoryError):
            continue
        except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
            _log.warning("cannot read %s (%s): computing it anew", folder / name, error)
    folder = first_writable(folders) or folders[0]
    _log.info("preparing the part: %s, once, kept in %s", kind.replace("_", " ").replace("-", " "), folder)
    arrays = compute()
    try:
        _write(folder / name, arrays)
    except OSError as error:
        _log.warning("cannot write %s: %s", folder / name, error)
    return arrays


def _folders() -> list[Path]:
    """Return where arrays are looked for; they are kept in the first one that can be written."""
    return [cache_folder(), *([] if os.environ.get("BINPICK_CACHE") else temporary_folders("cache"))]


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
