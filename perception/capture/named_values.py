"""Numbers among the named values of a calibration, in the forms that programs write."""

from collections.abc import Mapping
from typing import Any

from perception.geometry import Floats, as_floats


def numbers_of(value: Any, key: str) -> Floats:
    """Return an array that OpenCV or ROS wrote as its numbers, in a row.

    Args:
        value: Nested lists, an array, or a mapping with the numbers under ``data``.
        key: Name of the value, for messages.

    Raises:
        ValueError: The value is none of these.
    """
    if isinstance(value, Mapping) and "data" not in value:
        raise ValueError(f"{key} must be a list of numbers, or have one under data, got the keys {sorted(value)}")
    data: Any = value["data"] if isinstance(value, Mapping) else value
    return as_floats(key, data).reshape(-1)


def number_of(value: Any, key: str) -> float:
    """Return a value as a number; text that is one counts, truth values do not.

    Raises:
        ValueError: The value is no number.
    """
    try:
        if isinstance(value, bool):
            raise TypeError
        return float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{key} must be a number, got {value!r}") from None
