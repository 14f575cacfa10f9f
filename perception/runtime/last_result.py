"""A cache of one result that is large: the former one goes before the next is made."""

from collections.abc import Callable, Hashable
from functools import update_wrapper
from typing import Generic, ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class LastResult(Generic[Arguments, Result]):
    """A function that keeps its last result, for calls with equal arguments.

    ``functools.lru_cache(maxsize=1)`` holds the former result while the next one is made, so that a process needs room
    for both. The arguments must be hashable.
    """

    def __init__(self, function: Callable[Arguments, Result]) -> None:
        """Wrap a function."""
        self._function = function
        self._kept: dict[Hashable, Result] = {}
        update_wrapper(self, function)

    def __call__(self, *arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        """Return the kept result of equal arguments, or forget it and call the function."""
        key = arguments, tuple(sorted(named.items()))
        if key not in self._kept:
            self.cache_clear()
            self._kept[key] = self._function(*arguments, **named)
        return self._kept[key]

    def cache_clear(self) -> None:
        """Forget the kept result."""
        self._kept.clear()
