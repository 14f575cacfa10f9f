"""A map over processes gives every result once, says when a worker is killed, and leaves nothing behind."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import cv2
import pytest

from binpick_env.jobs.process_map import WorkerError, map_indices
from perception.runtime.file_work import InputWork

_start = "untouched"


def square(index: int) -> int:
    return index * index


def fail_at(which: int, index: int) -> int:
    if index == which:
        raise FloatingPointError(f"index {index} diverged")
    return index


def die_at(which: int, index: int) -> int:
    if index == which:
        os.kill(os.getpid(), signal.SIGKILL)
    return index


def linger(folder: Path, index: int) -> int:
    """Write the id of this process, and keep running."""
    draft = folder / f"draft {index}"
    draft.write_text(str(os.getpid()))
    draft.rename(folder / str(index))
    time.sleep(600)
    return index


def remember(name: str) -> None:
    global _start
    _start = name


def circumstances(index: int) -> tuple[int, int, str, int, str, bool]:
    """Return where and how a worker computes; a Ctrl-C sent to it must not end it."""
    if multiprocessing.parent_process() is not None:
        os.kill(os.getpid(), signal.SIGINT)
    ignores = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    return index, os.getpid(), _start, cv2.getNumThreads(), os.environ["OMP_NUM_THREADS"], ignores


# --- in this process -------------------------------------------------------------------------------------------------


def test_one_worker_computes_here_lazily_and_in_order() -> None:
    seen: list[int] = []
    results = map_indices(lambda index: seen.append(index) or 10 * index, [3, 1, 2], 1)
    assert seen == []
    assert next(results) == 30
    assert seen == [3]
    assert list(results) == [10, 20]


def test_files_of_single_indices_are_read_where_they_are(tmp_path: Path) -> None:
    paths = [tmp_path / "a", tmp_path / "b"]
    for path in paths:
        path.write_text(path.name)
    work = InputWork(lambda index: paths[index].read_text(), {k: [path] for k, path in enumerate(paths)})
    assert list(map_indices(work, range(2), 1)) == ["a", "b"]


def test_one_index_needs_no_process() -> None:
    ((index, pid, start, threads, variable, _),) = map_indices(circumstances, [7], 8, remember, ("never called here",))
    assert (index, pid, start, threads, variable) == (7, os.getpid(), "untouched", 1, "1")


def test_nothing_to_do_is_nothing() -> None:
    assert list(map_indices(square, [], 4)) == []


def test_the_threads_are_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "5")
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        for result in map_indices(circumstances, [0, 1], 1):
            assert result[3:5] == (1, "1")
            assert (cv2.getNumThreads(), os.environ["OMP_NUM_THREADS"]) == (2, "5")  # the consumer is not held to one
    finally:
        cv2.setNumThreads(before)


def test_an_error_is_raised_unchanged() -> None:
    results = map_indices(partial(fail_at, 1), [0, 1, 2], 1)
    assert next(results) == 0
    with pytest.raises(FloatingPointError, match="index 1 diverged"):
        next(results)


@pytest.mark.parametrize("workers", [0, -2])
def test_a_number_of_workers_below_one_is_refused(workers: int) -> None:
    with pytest.raises(ValueError, match=f"workers must be at least 1, got {workers}"):
        list(map_indices(square, [1, 2], workers))


# --- in many ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_workers_run_the_initializer_compute_on_one_core_and_ignore_ctrl_c() -> None:
    results = list(map_indices(circumstances, range(8), 2, remember, ("started",)))
    assert sorted(result[0] for result in results) == list(range(8))
    pids = {result[1] for result in results}
    assert os.getpid() not in pids
    assert len(pids) <= 2
    assert {result[2:] for result in results} == {("started", 1, "1", True)}
    assert _start == "untouched"
    assert multiprocessing.active_children() == []


def test_a_killed_worker_is_named() -> None:
    with pytest.raises(WorkerError, match="a worker was killed, perhaps for want of memory; try fewer workers"):
        list(map_indices(partial(die_at, 2), range(6), 2))
    assert multiprocessing.active_children() == []


def test_an_error_in_a_worker_is_raised_unchanged() -> None:
    with pytest.raises(FloatingPointError, match="index 1 diverged"):
        list(map_indices(partial(fail_at, 1), range(4), 2))
    assert multiprocessing.active_children() == []


def test_an_iteration_that_is_closed_early_leaves_no_process() -> None:
    results = map_indices(square, range(50), 2)
    assert next(results) in {index * index for index in range(50)}
    results.close()  # type: ignore[attr-defined]
    assert multiprocessing.active_children() == []


def lives(pid: int) -> bool:
    """Whether there is such a process; one that has ended and that nobody has asked for does not count."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes as Linux lists them")
def test_workers_do_not_outlive_a_parent_that_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(
        "import sys\nfrom functools import partial\nfrom pathlib import Path\n"
        "from binpick_env.jobs.process_map import map_indices\n"
        f"sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "from test_process_map import linger\n"
        "if __name__ == '__main__':\n"
        f"    list(map_indices(partial(linger, Path({str(tmp_path)!r})), range(2), 2))\n"
    )
    parent = subprocess.Popen([sys.executable, str(script)])
    try:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and not all((tmp_path / name).exists() for name in "01"):
            assert parent.poll() is None
            time.sleep(0.05)
        pids = [int((tmp_path / name).read_text()) for name in "01"]
        assert all(lives(pid) for pid in pids)
    finally:
        parent.kill()
        parent.wait()
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline and any(lives(pid) for pid in pids):
        time.sleep(0.05)
    assert not any(lives(pid) for pid in pids)
