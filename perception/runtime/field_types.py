"""Whether the fields of a dataclass that was made from a file or by a caller hold what their annotations say."""

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from numbers import Integral, Real
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np


def require_field_types(record: Any) -> None:
    """Check the fields of a dataclass, and those of the dataclasses in it.

    Whole numbers fit ``float``, and numpy's numbers and arrays fit as Python's do. A missing number fits only as a
    value of a dictionary, since JSON knows no NaN. Choices of words, which name themselves what they may be, are not
    checked.

    Args:
        record: Dataclass whose annotations are numbers, text, None, enums, tuples, dictionaries or dataclasses.

    Raises:
        ValueError: A field holds something else; the message names it.
    """
    for name, hint in get_type_hints(type(record)).items():
        value = getattr(record, name)
        if not _fits(value, hint):
            shown = hint.__name__ if isinstance(hint, type) else str(hint)
            raise ValueError(f"{name} must be {shown}, got {repr(value)[:60]}")


def require_finite(record: Any) -> None:
    """Check that every number in the fields of a dataclass, and in tuples in them, is finite.

    Raises:
        ValueError: A number is infinite or NaN; the message names its field.
    """
    for each in fields(record):
        value = getattr(record, each.name)
        numbers = value if isinstance(value, tuple | list | np.ndarray) else (value,)
        if not all(math.isfinite(number) for number in numbers if isinstance(number, Real)):
            raise ValueError(f"{each.name} must be finite, got {value}")


def _fits(value: Any, hint: Any) -> bool:
    kind, inner = get_origin(hint), get_args(hint)
    if hint is Any or kind is Literal:
        return True
    if kind in (Union, UnionType):
        return any(_fits(value, each) for each in inner)
    if kind is tuple:
        if not isinstance(value, tuple | list | np.ndarray) or np.ndim(value) == 0:
            return False
        if len(inner) == 2 and inner[1] is ...:
            return all(_fits(each, inner[0]) for each in value)
        return len(value) == len(inner) and all(map(_fits, value, inner))
    if kind in (dict, Mapping):
        return isinstance(value, dict) and all(
            _fits(key, inner[0]) and (each is None or _fits(each, inner[1])) for key, each in value.items()
        )
    if hint in (int, float):
        return isinstance(value, Integral if hint is int else Real) and not isinstance(value, bool)
    if isinstance(hint, type) and is_dataclass(hint) and isinstance(value, hint):
        require_field_types(value)
        return True
    return isinstance(value, kind or hint)
