"""A map over indices as it is sent to the nodes of a cluster, and what comes back."""

import hashlib
import io
import os
import pickle
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, SupportsIndex

import cloudpickle

from perception.runtime.file_work import FolderWork
from perception.runtime.job_files import installed_weights


@dataclass(frozen=True, kw_only=True)
class SentFile:
    """A file that a job, or an index of it, reads.

    Attributes:
        names: Absolute paths on the machine on which the job was started, the one without symbolic links last.
        content: Bytes of the file; on a node, a buffer of them that all of its workers share.
    """

    names: tuple[str, ...]
    content: bytes

    @classmethod
    def read(cls, path: Path) -> "SentFile":
        """Read a file of this machine."""
        named = os.path.abspath(path)  # noqa: PTH100 - symbolic links stay
        return cls(names=(named, str(path.resolve())), content=path.read_bytes())

    def __reduce_ex__(self, protocol: SupportsIndex) -> tuple[Any, ...]:
        """Let Ray keep the content in shared memory, where no worker needs a copy of it."""
        return _sent, (self.names, pickle.PickleBuffer(self.content) if int(protocol) >= 5 else self.content)


@dataclass(frozen=True, kw_only=True)
class Job:
    """A map over indices.

    Attributes:
        work: Pickled function, initializer and its arguments, see :func:`binpick_env.jobs.process_map.map_indices`.
        name: Name of the function, by which work of one kind is recognised.
        start: Working directory of the process that started the job.
        files: Files that the work names.
        weights: Installed weights, by the names of their files.
        digest: SHA-256 of both.
    """

    work: bytes
    name: str
    start: str
    files: tuple[SentFile, ...]
    weights: Mapping[str, bytes]
    digest: str

    @classmethod
    def of(
        cls,
        work: Callable[[int], Any],
        initializer: Callable[..., None] | None,
        initargs: tuple[Any, ...],
        inputs: Iterable[Path] = (),
    ) -> "Job":
        """Pack a map with the installed weights, and with every file whose path is a text or a path in the map.

        A part's file and a network's are therefore found wherever they stand in the settings. Files that single indices
        read, ``inputs``, are left out.
        """
        packed = io.BytesIO()
        pickler = _Pickler(packed, protocol=pickle.HIGHEST_PROTOCOL)
        pickler.dump((work, initializer, initargs))
        apart = {path.resolve() for path in inputs}
        paths = [Path(text) for text in sorted(pickler.texts) if _is_file(text)]
        files = tuple(SentFile.read(path) for path in paths if path.resolve() not in apart)
        weights = {path.name: path.read_bytes() for path in sorted(installed_weights().glob("*.safetensors"))}
        return cls(
            work=packed.getvalue(),
            name=_name(work),
            start=str(Path.cwd()),
            files=files,
            weights=weights,
            digest=_digest([*((repr(file.names), file.content) for file in files), *weights.items()]),
        )


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a node sends back.

    Attributes:
        result: Result of the work.
        files: Content of the files that the work wrote, by their paths in its folder, in the order of writing.
    """

    result: Any
    files: Mapping[str, bytes]


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc]
    """A pickler that remembers the texts and paths that it meets."""

    def __init__(self, file: io.BytesIO, protocol: int) -> None:
        super().__init__(file, protocol=protocol)
        self.texts: set[str] = set()

    def persistent_id(self, value: Any) -> None:
        if isinstance(value, str | Path):
            self.texts.add(str(value))


def _sent(names: tuple[str, ...], content: bytes) -> SentFile:
    return SentFile(names=names, content=content)


def _digest(contents: Iterable[tuple[str, bytes]]) -> str:
    total = hashlib.sha256()
    for name, content in contents:
        total.update(f"{name}\0{len(content)}\0".encode(errors="surrogateescape"))
        total.update(content)
    return total.hexdigest()


def _is_file(text: str) -> bool:
    """Tell whether a text is the path of a file; names of parts have no suffix."""
    try:
        return bool(Path(text).suffix) and Path(text).is_file()
    except (OSError, ValueError):  # too long, or with characters that no path has
        return False


def _name(work: Any) -> str:
    """Return the name of the function behind work."""
    while isinstance(work, partial | FolderWork):
        work = work.func if isinstance(work, partial) else work.function
    return f"{work.__module__}.{getattr(work, '__qualname__', type(work).__qualname__)}"
