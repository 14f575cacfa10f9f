"""Where compiled kernels are kept: numba refuses to compile one if none of its usual folders can be written."""

import os
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

_VARIABLE = "NUMBA_CACHE_DIR"
_PACKAGE = Path(__file__).parents[1]


def use_writable_kernel_cache() -> None:
    """Let numba keep kernels in the cache folder, or else in a temporary one, where its own folders are read-only.

    Its own folders are that of the package and the user's cache folder. ``NUMBA_CACHE_DIR`` is obeyed where it is set.
    The folder is passed on to processes that are started later.
    """
    if os.environ.get(_VARIABLE) or _is_writable(_PACKAGE / "__pycache__") or _is_writable(_numbas_user_folder()):
        return
    from perception.runtime.cache import cache_folder  # here, since every import of the package runs this module

    folder = first_writable([cache_folder() / "kernels", *temporary_folders("kernels")])
    if folder is None:
        return  # numba says what it tried
    os.environ[_VARIABLE] = str(folder)
    numba = sys.modules.get("numba")
    if numba is not None:  # it read the environment when it was loaded
        numba.config.CACHE_DIR = str(folder)


def temporary_folders(kind: str) -> list[Path]:
    """Return this user's folder for ``kind`` in the system's temporary folder; none where no such one can be written.

    It belongs to this user alone, since what is in it is trusted.
    """
    try:
        folder = Path(tempfile.gettempdir()) / f"binpick-{kind}-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        return [folder] if folder.stat().st_uid == os.getuid() else []
    except OSError:  # FileNotFoundError, too, where every place for temporary files is read-only
        return []


def first_writable(folders: Iterable[Path]) -> Path | None:
    """Return the first folder in which files can be written, or None."""
    return next((folder for folder in folders if _is_writable(folder)), None)


def _numbas_user_folder() -> Path:
    """Return the folder that numba takes where a package is read-only."""
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "numba"  # noqa: PTH111 - no home


def _is_writable(folder: Path) -> bool:
    """Try to write a file, which tells more than the folder's permissions: the user may be root, the disk read-only."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False
