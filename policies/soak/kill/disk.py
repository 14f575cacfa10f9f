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
def small_disk(folder: Path, size: int, largest_file: int) -> Iterator[SmallDisk]:
    """Make a folder with little room for the time of this context.

    Args:
        folder: Folder to make.
        size: Room in a file system of its own [bytes], rounded up to whole pages.
        largest_file: Size beyond which no file can be written where none can be mounted [bytes].
    """
    folder.mkdir(parents=True, exist_ok=True)
    room = -(-size // _PAGE) * _PAGE
    if not _call("mount", "-t", "tmpfs", "-o", f"size={room}", "tmpfs", str(folder)):
        yield SmallDisk(folder, largest_file=largest_file)
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
