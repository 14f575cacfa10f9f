"""NPY and NPZ files from anywhere: what their headers announce is compared with what they hold before it is read."""

import os
from pathlib import Path
from typing import IO, Any
from zipfile import ZipFile

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

LARGEST = 1_000_000_000  # most bytes that a file may hold; a room of 10 million points takes 0.4 GB
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def load_npz(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an NPZ file by name.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It holds objects, more than `LARGEST` bytes once unpacked, or less than an array's header
            announces.

    Note:
        Files that are no archives, or damaged, raise what the zip format and numpy raise.
    """
    with path.open("rb") as file:
        with ZipFile(file) as archive:
            members = archive.infolist()
            require_bytes(path.name, sum(member.file_size for member in members))
            for member in members:
                with archive.open(member) as content:
                    _require_whole(f"{member.filename} in {path.name}", content, member.file_size)
        file.seek(0)
        with np.load(file, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}


def load_npy(path: Path) -> NDArray[Any]:
    """Return the array of an NPY file.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It holds objects, more than `LARGEST` bytes, or less than its header announces.
    """
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        require_bytes(path.name, size)
        _require_whole(path.name, file, size)
        file.seek(0)
        array: NDArray[Any] = np.load(file, allow_pickle=False)
    return array


def require_bytes(name: str, size: int) -> None:
    """Refuse content that would fill the memory.

    Args:
        name: Name of the file, for the message.
        size: Number of bytes that it takes, unpacked.

    Raises:
        ValueError: It takes more than `LARGEST` bytes.
    """
    if size > LARGEST:
        raise ValueError(f"{name} must hold at most {LARGEST / 1e9:g} GB, got {size / 1e9:.3g} GB")


def _require_whole(name: str, content: IO[bytes], size: int) -> None:
    """Refuse an NPY whose header announces more than the ``size`` bytes that it has."""
    version = npy.read_magic(content)
    if version not in _HEADERS:
        raise ValueError(f"{name} must be NPY of version 1.0 or 2.0, got {version}")
    shape, _, dtype = _HEADERS[version](content)
    announced, held = dtype.itemsize * int(np.prod(shape, dtype=object)), size - content.tell()
    if not dtype.hasobject and announced > held:
        raise ValueError(f"{name} announces {announced} bytes, an array of {shape}, but holds {held}")
