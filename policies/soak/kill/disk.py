"""A disk that is full: a small file system in memory, or a limit on the size of files where none can be mounted."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_PAGE = 4096  # bytes


class SmallDisk:
    """A folder with little room.

    Attributes:
        folder: The folder.
        largest_file: Size beyond which a process must be kept from writing [bytes]; None on a file system of its own.
    """

    def __init__(self, folder: Path, largest_file: int | None) -> None:
        """Describe a folder that exists."""
        self.folder = folder
        self.largest_file = largest_file

    @property
    def how(self) -> str:
        """What makes the disk full."""
        return "tmpfs" if self.largest_file is None else "RLIMIT_FSIZE"

    def grow(self) -> None:
        """Give it room enough."""
        if self.largest_file is None:
            _call("mount", "-o", "remount,size=512m", str(self.folder))
        self.largest_file = None


@contextmanager
def small_disk(folder: Path, size: int) -> Iterator[SmallDisk]:
    """Make a folder with room for ``size`` bytes, rounded up to whole pages, for the time of this context."""
    folder.mkdir(parents=True, exist_ok=True)
    room = -(-size // _PAGE) * _PAGE
    if not _call("mount", "-t", "tmpfs", "-o", f"size={room}", "tmpfs", str(folder)):
        yield SmallDisk(folder, largest_file=max(size // 4, 1))
        return
    try:
        yield SmallDisk(folder, largest_file=None)
    finally:
        _call("umount", str(folder))


def _call(*words: str) -> bool:
    try:
        return subprocess.run(words, capture_output=True, check=False, timeout=30).returncode == 0
    except OSError:  # there is no such program
        return False
