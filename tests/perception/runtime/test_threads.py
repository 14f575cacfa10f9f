"""One thread setting for OpenCV and torch."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from types import ModuleType

import cv2
import pytest
import torch

from perception.runtime.threads import default_threads, in_threads, use_threads


@pytest.fixture
def three_threads() -> Iterator[None]:
    """Use a number that neither a test nor a default sets."""
    before = torch.get_num_threads(), cv2.getNumThreads()
    torch.set_num_threads(3)
    cv2.setNumThreads(3)
    yield
    torch.set_num_threads(before[0])
    cv2.setNumThreads(before[1])


def threads() -> tuple[int, int]:
    return torch.get_num_threads(), cv2.getNumThreads()


def test_it_holds_inside_and_nowhere_else(three_threads: None) -> None:
    with use_threads(1):
        assert threads() == (1, 1)
        with use_threads(2):
            assert threads() == (2, 2)
        assert threads() == (1, 1)
    assert threads() == (3, 3)


def test_a_fault_inside_leaves_nothing_behind(three_threads: None) -> None:
    with pytest.raises(KeyError), use_threads(1):
        raise KeyError
    assert threads() == (3, 3)


def test_none_leaves_the_libraries_alone(three_threads: None) -> None:
    with use_threads(None):
        assert threads() == (3, 3)
        cv2.setNumThreads(2)
    assert threads() == (3, 2)


def test_one_thread_unless_a_context_says_otherwise(three_threads: None) -> None:
    assert default_threads() == 1
    with use_threads(4):
        assert default_threads() == 4
        with use_threads(2), use_threads(None):
            assert default_threads() == 2
        assert default_threads() == 4
    assert default_threads() == 1


def test_contexts_of_several_threads_leave_nothing_behind(three_threads: None) -> None:
    """Entered and left in turn: the setting before the first returns with the last, in both threads."""
    torch.set_num_threads(3)
    inside, out = threading.Event(), threading.Event()
    seen: dict[str, tuple[int, int]] = {}

    def other() -> None:
        with use_threads(2):
            seen["other, inside"] = threads()
            inside.set()
            out.wait(10)
            seen["other, alone"] = threads()
        seen["other, after"] = threads()
        assert default_threads() == 1

    thread = threading.Thread(target=other)
    with use_threads(1):
        thread.start()
        inside.wait(10)
        seen["both"] = threads()
    seen["after"] = threads()
    fresh: list[int] = []
    asker = threading.Thread(target=lambda: fresh.append(torch.get_num_threads()))
    asker.start()
    asker.join()
    out.set()
    thread.join()
    assert seen == {
        "other, inside": (2, 1),
        "both": (1, 1),
        "after": (3, 2),
        "other, alone": (2, 2),
        "other, after": (3, 3),
    }
    assert fresh == [2]  # what threads share is that of those still inside
    assert threads() == (3, 3)


def test_torch_that_another_thread_is_loading_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", ModuleType("torch"))
    with use_threads(2):
        assert cv2.getNumThreads() == 2


NUMBA_QUERIES = """
import numba, torch
from perception.runtime.threads import use_threads
torch.set_num_threads(2)
with use_threads(1):
    assert numba.get_num_threads() == 3
    assert torch.get_num_threads() == 1, torch.get_num_threads()
assert torch.get_num_threads() == 2
"""


@pytest.mark.slow
def test_a_query_of_numbas_threads_leaves_torch_alone() -> None:
    """Numba's start of its threads sets OpenMP's number, which torch shares, to all cores."""
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", NUMBA_QUERIES], env=environment | {"NUMBA_NUM_THREADS": "3"})
    assert done.returncode == 0


@pytest.mark.parametrize("count", [0, -1, 1.5, "2"])
def test_what_is_no_number_of_threads_is_refused(count: int) -> None:
    text = f"threads must be a whole number, at least 1, got {count!r}"
    with pytest.raises(ValueError, match=text), use_threads(count):
        pass


def test_it_does_not_load_torch() -> None:
    code = """
import sys, cv2
from perception.runtime.threads import in_threads, use_threads
with use_threads(1):
    assert cv2.getNumThreads() == 1
sys.exit("torch" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_work_in_threads_is_in_order_on_any_number(threads: int) -> None:
    with use_threads(threads):
        assert in_threads(lambda n: n * n, range(20)) == [n * n for n in range(20)]
        assert in_threads(lambda n: n, []) == []


def test_as_many_threads_work_as_opencv_may_use() -> None:
    together = threading.Barrier(2, timeout=10)
    with use_threads(2):
        in_threads(lambda _: together.wait(), range(2))  # ends only if both are at it at once
    with use_threads(1):
        assert set(in_threads(lambda _: threading.get_ident(), range(4))) == {threading.get_ident()}


def test_an_error_in_a_thread_reaches_the_caller() -> None:
    with use_threads(2), pytest.raises(ZeroDivisionError):
        in_threads(lambda n: 1 // n, [1, 0, 1])
