"""Works that the tests of a cluster compute on its nodes; worker processes import this module."""

import os
import signal
import threading
import time
from pathlib import Path

from binpick_env.parts.part import load_part
from perception.runtime.job_files import local_file
from perception.runtime.provenance import command_line, git_commit
from perception.segmentation.weights import user_folder

_start = "untouched"


def remember(name: str) -> None:
    global _start
    _start = name


def circumstances(index: int) -> tuple[int, int, str, dict[str, int]]:
    """Return where an index is computed, and the numbers of threads."""
    import cv2
    import numba
    import torch

    threads = {
        "OpenMP": int(os.environ["OMP_NUM_THREADS"]),
        "numba": numba.get_num_threads(),
        "OpenCV": cv2.getNumThreads(),
        "torch": torch.get_num_threads(),
    }
    return index, os.getpid(), _start, threads


def provenance(index: int) -> tuple[str, str]:
    return command_line(), git_commit()


def square(index: int) -> int:
    return index * index


def make_lock(index: int) -> object:
    return threading.Lock()


def fail_at(which: int, index: int) -> int:
    if index == which:
        raise FloatingPointError(f"index {index} diverged")
    return index


def die_once(folder: Path, which: int, index: int) -> int:
    """Kill this process, but not that of the second attempt; each has the files of the index."""
    if index == which:
        assert local_file(folder / "input") != folder / "input"
        if not (folder / "died").exists():
            (folder / "died").touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return index


def die(index: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return index


def linger(folder: Path, index: int) -> int:
    """Return index 0; for another one write the id of this process, and keep running."""
    if index == 0:
        return index
    draft = folder / f"draft {index}"
    draft.write_text(str(os.getpid()))
    draft.rename(folder / "pid")
    time.sleep(600)
    return index


def write_letters(count: int, folder: Path, index: int) -> int:
    """Write files into a folder that holds nothing else, one of them below it."""
    assert list(folder.iterdir()) == []
    (folder / "more").mkdir()
    (folder / "more" / f"first {index}.bin").write_bytes(bytes(range(count)))
    time.sleep(0.02)  # longer than the resolution of a file's time
    (folder / f"last {index}.txt").write_text("ß" * index, encoding="utf-8")
    return index


def read_own(paths: list[Path], index: int) -> tuple[bytes, Path, list[bool]]:
    """Return the file of an index, where it lies, and of which indices the files are there."""
    copies = [local_file(path) for path in paths]
    return copies[index].read_bytes(), copies[index], [copy != path for copy, path in zip(copies, paths, strict=True)]


def weigh_without_the_file(part: str, index: int) -> tuple[float, str, str]:
    """Remove a part's file and load the part."""
    Path(part).unlink(missing_ok=True)
    os.chdir("/")
    loaded = load_part(part)
    return loaded.mass, loaded.source, loaded.model.name


def installed(index: int) -> dict[str, bytes]:
    """Return the files of the installed weights."""
    return {path.name: path.read_bytes() for path in user_folder().iterdir()}


class Counting:
    """Counts its calls in the process that holds it."""

    def __init__(self, path: str, index: int) -> None:
        self.index, self._calls = index, 0
        self._file = local_file(Path(path)).read_bytes()

    def count(self, step: int) -> tuple[int, int]:
        self._calls += step
        return self.index, self._calls

    def file(self) -> bytes:
        return self._file

    def circumstances(self) -> tuple[int, int, str, dict[str, int]]:
        return circumstances(self.index)

    def process(self) -> int:
        return os.getpid()

    def fail(self) -> None:
        raise FloatingPointError(f"object {self.index} diverged")

    def die(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


class Sleeping:
    """Takes as long as it is told."""

    def __init__(self, index: int) -> None:
        self.index = index

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)
