"""Files that a job reads: those at their paths, or on a node of a cluster the copies that came with the job.

A part's file and a network's weights are named by paths of the machine on which a job was started. Records and
settings keep these paths on every node, so that they are the same wherever they are computed. Whoever opens such a
file asks :func:`local_file` where it lies.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

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
        return self.files.get(os.path.normpath(Path(self.start) / path))


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
    """Return the absolute path of a file without symbolic links, on the machine on which the job was started."""
    found = None if _job is None else _job.find(path)
    return str(path.resolve()) if found is None else found.resolved


def installed_weights() -> Path:
    """Return the folder of the weights that the user has installed, or of the copies that came with the job."""
    return cache_folder() / "weights" if _job is None else _job.weights
