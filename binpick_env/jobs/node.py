"""What a worker process of a cluster's node does: it unpacks a job once, then computes index after index.

A node needs nothing but the same build of the project. Files come with the job, or with the index that reads them, and
results go back with the bytes of the files that the work has written; the node keeps copies and drafts in a temporary
folder.
"""

import fcntl
import hashlib
import os
import pickle
import shutil
import socket
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2

from binpick_env.jobs.build import build, differences
from binpick_env.jobs.cluster_job import Job, Outcome, SentFile
from binpick_env.jobs.workers import WorkerError
from perception.runtime.file_work import FolderWork
from perception.runtime.job_files import JobFile, JobFiles, use_job_files
from perception.runtime.threads import one_core

_LEFT_OVER = 60.0  # age from which a folder that no worker holds is that of a killed one, and is removed [s]
_UNUSED = 30 * 86_400.0  # time after the last start of a worker from which the files of a job are removed [s]


@dataclass(frozen=True, kw_only=True)
class _LoadedJob:
    key: str
    name: str
    work: Callable[[int], Any]
    files: JobFiles


_loaded: _LoadedJob | None = None  # job of this process
_begun: set[str] = set()  # names of the work that this process has begun


def compute(
    key: str,
    required: Mapping[str, str],
    fetch: Callable[[], Job],
    index: int,
    fetch_inputs: Callable[[], Sequence[SentFile]] = tuple,
) -> Outcome:
    """Compute one index of a job.

    Args:
        key: Identifies the job.
        required: Build of the process that started the job.
        fetch: Returns the job; called once in each process.
        index: Index to compute.
        fetch_inputs: Returns the files that this index reads besides those of the job.

    Raises:
        WorkerError: This node runs another build; or the work raised what cannot be sent back. What else it raises is
            raised unchanged.
    """
    global _loaded
    if _loaded is None or _loaded.key != key:
        _require_build(required)
        _loaded = _load(key, fetch())
    inputs = fetch_inputs()
    with _sendable_errors(), _laid_out(inputs, _loaded.files), _compiled_once(_loaded.name), one_core():
        if isinstance(_loaded.work, FolderWork):
            return _in_own_folder(_loaded.work, index)
        return Outcome(result=_loaded.work(index), files={})


class NodeObject:
    """An object that a job makes in a process of its own, and whose methods are called from another machine.

    Args:
        required: Build of the process that started the job.
        fetch: Returns the job, whose work makes the object of an index.
        index: Index of the object.

    Raises:
        WorkerError: As :func:`compute`; its methods likewise.
    """

    def __init__(self, required: Mapping[str, str], fetch: Callable[[], Job], index: int) -> None:
        _require_build(required)
        loaded = _load("", fetch())
        with _sendable_errors(), _compiled_once(loaded.name), one_core():
            self._object: Any = loaded.work(index)

    def call(self, method: str, arguments: Sequence[Any]) -> Outcome:
        """Call a method of the object."""
        with _sendable_errors(), one_core():
            return Outcome(result=getattr(self._object, method)(*arguments), files={})


@contextmanager
def _sendable_errors() -> Iterator[None]:
    """Let errors arrive as they are, or with their texts where they would not."""
    try:
        yield
    except (Exception, SystemExit) as error:
        if (sendable := _sendable(error)) is error:
            raise
        raise sendable from error


def _sendable(error: BaseException) -> BaseException:
    """Return an error that arrives as it is; one of another kind with its text where it would not."""
    if isinstance(error, Exception):
        with suppress(Exception):
            arrived = pickle.loads(pickle.dumps(error))
            if type(arrived) is type(error) and str(arrived) == str(error):
                return error
    return WorkerError(f"the work failed: {type(error).__name__}: {error}")


def node_folder() -> Path:
    """Return the folder of this user's files on this node, which is created.

    Raises:
        WorkerError: It belongs to another user.
    """
    folder = Path(tempfile.gettempdir()) / f"binpick-node-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.stat().st_uid != os.getuid():
        raise WorkerError(f"{folder} on {socket.gethostname()} must belong to the user of the worker: remove it")
    return folder


def _require_build(required: Mapping[str, str]) -> None:
    if different := "; ".join(differences(required, build())):
        raise WorkerError(
            f"the node {socket.gethostname()} runs another build of binpick than this machine ({different}): install "
            "the same one on every node"
        )


def _load(key: str, job: Job) -> _LoadedJob:
    files = _unpacked(job)
    use_job_files(files)
    cv2.setNumThreads(1)
    work, initializer, initargs = pickle.loads(job.work)
    if initializer is not None:
        initializer(*initargs)
    _remove_left_over()
    return _LoadedJob(key=key, name=job.name, work=work, files=files)


def _unpacked(job: Job) -> JobFiles:
    """Write the files of a job into the node's folder, once per node."""
    folder = node_folder() / "inputs" / job.digest[:16]
    copies, weights = _copies(job.files, folder), folder / "weights"
    with _locked("inputs"):
        if folder.exists() and not all(file.copy.exists() for file in copies.values()):
            shutil.rmtree(folder)  # something that cleans up temporary files has removed some
        if not folder.exists():
            draft = folder.with_name(f".{folder.name}")
            shutil.rmtree(draft, ignore_errors=True)
            _write_copies(job.files, draft)
            for name, content in job.weights.items():
                _write(draft / "weights" / name, content)
            draft.mkdir(parents=True, exist_ok=True)  # a job may have no files
            draft.rename(folder)
        os.utime(folder)
    return JobFiles(start=job.start, files=copies, weights=weights)


@contextmanager
def _laid_out(inputs: Sequence[SentFile], others: JobFiles) -> Iterator[None]:
    """Let work find the files of an index beside the others, and remove them afterwards."""
    if not inputs:
        yield
        return
    with _draft_folder() as folder:
        _write_copies(inputs, folder)
        use_job_files(replace(others, files={**others.files, **_copies(inputs, folder)}))
        try:
            yield
        finally:
            use_job_files(others)


def _copies(files: Sequence[SentFile], folder: Path) -> dict[str, JobFile]:
    """Return the copies of files in a folder, by the files' names."""
    placed = zip(files, _places(files, folder), strict=True)
    return {name: JobFile(resolved=file.names[-1], copy=copy) for file, copy in placed for name in file.names}


def _places(files: Sequence[SentFile], folder: Path) -> list[Path]:
    return [folder / str(k) / Path(file.names[0]).name for k, file in enumerate(files)]


def _write_copies(files: Sequence[SentFile], folder: Path) -> None:
    for file, copy in zip(files, _places(files, folder), strict=True):
        _write(copy, file.content)


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


@contextmanager
def _draft_folder() -> Iterator[Path]:
    """Make an empty folder, hold it, and remove it afterwards."""
    drafts = node_folder() / "drafts"
    drafts.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir=drafts) as name, _held(Path(name) / "lock"):
        folder = Path(name) / "files"
        folder.mkdir()
        yield folder


def _in_own_folder(work: FolderWork[Any], index: int) -> Outcome:
    """Compute an index in a new folder, and take the files out of it."""
    with _draft_folder() as folder:
        result = work.function(folder, index)
        written = sorted(filter(Path.is_file, folder.rglob("*")), key=lambda path: path.stat().st_mtime_ns)
        files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in written}
    return Outcome(result=result, files=files)


def _remove_left_over() -> None:
    """Remove the folders that killed workers have left, and the files of jobs that have not run for a month."""
    for kind, age in (("drafts", _LEFT_OVER), ("inputs", _UNUSED)):
        for folder in (node_folder() / kind).glob("*"):
            with suppress(FileNotFoundError):  # another worker removes it, too
                if time.time() - folder.stat().st_mtime > age and not _is_held(folder / "lock"):
                    shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _compiled_once(name: str) -> Iterator[None]:
    """Let the first work of a kind be computed alone on a node: it compiles the kernels that others then load."""
    if name in _begun:
        yield
        return
    _begun.add(name)
    facts = (*build().items(), str(Path(__file__).parent), os.environ.get("NUMBA_CACHE_DIR"), name)
    done = node_folder() / f"compiled-{hashlib.sha256(repr(facts).encode()).hexdigest()[:16]}"
    if not done.exists():
        with _locked(done.name):
            if not done.exists():
                yield
                done.touch()
                return
    yield


@contextmanager
def _locked(name: str) -> Iterator[None]:
    """Keep other processes of this node out."""
    with _held(node_folder() / f"{name}.lock"):
        yield


@contextmanager
def _held(lock: Path) -> Iterator[None]:
    """Hold a lock, which is released when the process is killed."""
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _is_held(lock: Path) -> bool:
    """Tell whether a process holds a lock; nobody holds one that is not there."""
    try:
        with lock.open("r+") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (FileNotFoundError, NotADirectoryError):
        return False
    except BlockingIOError:
        return True
    return False
