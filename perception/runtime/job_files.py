"""Files that a job reads: those at their paths, or on a node of a cluster the copies that came with the job.

A part's file and a network's weights are named by paths of the machine on which a job was started. Records and
settings keep these paths on every node, so that they are the same wherever they are computed. Whoever opens such a
file asks :func:`local_file` where it lies.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath

from perception.runtime.cache import cache_folder


@dataclass(frozen=True, kw_only=True)
class JobFile:
    """Copy of another machine's file.

    Attributes:
        resolved: Path there, absolute and without symbolic links.
        copy: Path on this machine; its name is the file's.
    """

    resolved: str
    copy: Path


@dataclass(frozen=True, kw_only=True)
class JobFiles:
    """Copies of another machine's files.

    Attributes:
        start: Working directory there, at which relative paths start.
        files: Copies by their absolute paths there.
        weights: Folder with copies of the weights that are installed there.
    """

    start: str
    files: Mapping[str, JobFile]
    weights: Path

    def find(self, path: Path) -> JobFile | None:
        """Return the copy of the file at a path of the other machine; None if it did not come with the job."""
        return self.files.get(self.absolute(path))

    def absolute(self, path: Path) -> str:
        """Return the absolute path there, in which symbolic links stay."""
        return os.path.normpath(Path(self.start) / path)

    def inside(self, folder: Path) -> list[PurePath]:
        """Return the paths of the files in a folder there and below it, relative to it and sorted."""
        around = self.absolute(folder)
        paths = (PurePath(name) for name in self.files)
        return sorted(path.relative_to(around) for path in paths if path.is_relative_to(around))


_job: JobFiles | None = None  # None: the job was started on this machine


def use_job_files(files: JobFiles | None) -> None:
    """Let this process read copies from now on; None lets it read the files themselves."""
    global _job
    _job = files


def local_file(path: Path) -> Path:
    """Return where the content of a file lies on this machine: at ``path``, or at its copy."""
    found = None if _job is None else _job.find(path)
    return path if found is None else found.copy


def resolved_path(path: Path) -> str:
    """Return the absolute path of a file without symbolic links, on the machine on which the job was started.

    A folder of the job's files is named by it as well, where its links were resolved when the job was started.
    """
    if _job is None:
        return str(path.resolve())
    if found := _job.find(path):
        return found.resolved
    return _job.absolute(path) if _job.inside(path) else str(path.resolve())


def find_files(folder: Path, pattern: str) -> list[Path]:
    """Return the files in a folder that match a pattern, sorted; on a node, those that came with the job.

    Args:
        folder: Folder on the machine on which the job was started.
        pattern: Glob of a fixed depth, such as ``*/*.npz``.
    """
    if _job is None:
        return sorted(folder.glob(pattern))
    depth = len(PurePath(pattern).parts)
    return [folder / path for path in _job.inside(folder) if len(path.parts) == depth and path.match(pattern)]


def installed_weights() -> Path:
    """Return the folder of the weights that the user has installed, or of the copies that came with the job."""
    return cache_folder() / "weights" if _job is None else _job.weights
