"""One thread setting for OpenCV and torch."""

import subprocess
import sys
import threading
from collections.abc import Iterator

import cv2
import pytest
import torch

from perception.runtime.threads import in_threads, use_threads


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


@pytest.mark.parametrize("count", [0, -1])
def test_no_threads_are_refused(count: int) -> None:
    with pytest.raises(ValueError, match=f"threads must be at least 1, got {count}"), use_threads(count):
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
