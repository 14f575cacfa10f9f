"""One thread setting for OpenCV and torch."""

import subprocess
import sys
from collections.abc import Iterator

import cv2
import pytest
import torch

from perception.threads import use_threads


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
from perception.threads import use_threads
with use_threads(1):
    assert cv2.getNumThreads() == 1
sys.exit("torch" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
