"""The arguments of the environments that no other class checks: numbers of parts and threads."""

from collections.abc import Mapping
from operator import index
from typing import Any

import numpy as np

from perception.runtime.threads import default_threads

RESET_OPTIONS = ("num_parts",)


def count_range(num_parts: int | tuple[int, int]) -> tuple[int, int]:
    """Return the smallest and the largest number of parts.

    Args:
        num_parts: Number of parts, or the range that it is drawn from; numpy's integers will do.

    Raises:
        ValueError: It is neither a positive whole number nor a rising pair of them.
    """
    pair = tuple(num_parts) if isinstance(num_parts, tuple | list) else (num_parts, num_parts)
    try:
        low, high = (_whole(number) for number in pair)
    except (TypeError, ValueError):
        low, high = 0, 0
    if not 1 <= low <= high:
        raise ValueError(f"num_parts must be a positive whole number or a rising pair of them, got {num_parts!r}")
    return low, high


def episode_count(options: Mapping[str, Any] | None, num_parts: tuple[int, int], rng: np.random.Generator) -> int:
    """Return the number of parts of an episode, drawn from its range unless ``options`` of the reset name it.

    Raises:
        ValueError: There is no such option, or the number is none.
    """
    if not (options is None or isinstance(options, Mapping)):
        raise ValueError(f"options of reset must be a dictionary, got {options!r}")
    given = dict(options or {})
    unknown = [name for name in given if name not in RESET_OPTIONS]
    if unknown:
        raise ValueError(
            f"options of reset must be among {', '.join(RESET_OPTIONS)}, got {', '.join(map(str, unknown))}"
        )
    drawn = int(rng.integers(num_parts[0], num_parts[1] + 1))
    if "num_parts" not in given:
        return drawn
    try:
        count = _whole(given["num_parts"])
    except TypeError:
        count = -1
    if not 0 <= count <= num_parts[1]:
        raise ValueError(
            f"num_parts of reset must be a whole number from 0 to {num_parts[1]}, the largest of this environment, "
            f"got {given['num_parts']!r}"
        )
    return count


def thread_count(threads: int | None) -> int:
    """Return the number of threads of an environment; unless given, that of ``use_threads`` around it, else one.

    Copies that take all cores each are several times slower than with one each.

    Raises:
        ValueError: It is no positive whole number.
    """
    if threads is None:
        return default_threads()
    try:
        count = _whole(threads)
    except TypeError:
        count = 0
    if count < 1:
        raise ValueError(f"threads must be a whole number of at least 1, got {threads!r}")
    return count


def _whole(number: Any) -> int:
    """Return a whole number, Python's or numpy's.

    Raises:
        TypeError: It is none; a truth value is none either.
    """
    if isinstance(number, bool):
        raise TypeError("a truth value is no number")
    return index(number)
