"""Which files the results of a frame are of: the digests of their contents."""

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from policies.frames.frame_files import images_of_frame

BLOCK = 1 << 20  # bytes that are read at once


def digests(frame: Path, grey: Path | None = None, calibration: Path | None = None) -> dict[str, str | None]:
    """Return the SHA-256 digests of the files that a frame is read from, by what they are; None for a missing file.

    Args:
        frame: File of the frame, the JSON file of one, whose images count, too, or the folder of a recording.
        grey: File of its grey image; None without one of its own.
        calibration: File of its calibration; None without one of its own.
    """
    files = {"frame": frame, "grey image": grey, "calibration": calibration}
    if frame.suffix.lower() == ".json":
        files |= {f"image {path.name}": path for path in sorted(images_of_frame(frame) or ())}
    return {role: _digest(path) for role, path in files.items() if path is not None}


def changes(stored: object, present: Mapping[str, str | None]) -> str | None:
    """Return in words how files differ from those of stored digests; None if they are the same.

    Args:
        stored: Digests that were stored with results; None if those of an older version have none.
        present: Digests of the files as they are.
    """
    if not isinstance(stored, Mapping):
        return "its results do not say which files they are of"
    roles = [role for role in {**present, **stored} if stored.get(role) != present.get(role)]
    return f"{', '.join(roles)} changed since its results were written" if roles else None


def _digest(path: Path) -> str | None:
    total = hashlib.sha256()
    try:
        for file in _files(path):
            if path.is_dir():
                total.update(f"{file.relative_to(path)}\0{file.stat().st_size}\0".encode())
            with file.open("rb") as stream:
                while block := stream.read(BLOCK):
                    total.update(block)
    except OSError:  # missing, or not to be read: what reads the frame says it
        return None
    return total.hexdigest()


def _files(path: Path) -> Iterator[Path]:
    """Yield a file, or the files of a folder in the order of their names."""
    if path.is_dir():
        yield from (file for file in sorted(path.rglob("*")) if file.is_file())
    else:
        yield path
