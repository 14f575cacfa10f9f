"""A map that hands its work on as one over processes does, without their start."""

import pickle
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

Result = TypeVar("Result")


def pickled_map(
    work: Callable[[int], Result],
    indices: Sequence[int],
    workers: int,
    initializer: Callable[..., None] | None = None,
    initargs: tuple[Any, ...] = (),
) -> Iterator[Result]:
    """Yield pickled copies of the results of pickled copies of ``work``, or of its error, the last index first."""
    assert workers > 1
    if initializer is not None:
        start, arguments = pickle.loads(pickle.dumps((initializer, initargs)))
        start(*arguments)
    for index in reversed(indices):
        copy: Callable[[int], Result] = pickle.loads(pickle.dumps(work))
        try:
            result: Result = copy(index)
        except Exception as error:
            raise pickle.loads(pickle.dumps(error)) from None
        yield pickle.loads(pickle.dumps(result))
