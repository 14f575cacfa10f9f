"""A map that hands its work on as one over processes does, without their start."""

import pickle
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

Result = TypeVar("Result")


def pickled_map(work: Callable[[int], Result], indices: Sequence[int], workers: int) -> Iterator[Result]:
    """Yield the results of pickled copies of ``work``, the last index first."""
    assert workers > 1
    for index in reversed(indices):
        copy: Callable[[int], Result] = pickle.loads(pickle.dumps(work))
        yield copy(index)
