"""Whether the fields of a dataclass that was made from a file hold what their annotations say."""

from collections.abc import Mapping
from dataclasses import is_dataclass
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints


def require_field_types(record: Any) -> None:
    """Check the fields of a dataclass, and those of the dataclasses in it.

    Whole numbers fit ``float``. A missing number fits it only as a value of a dictionary, since JSON knows no NaN.

    Args:
        record: Dataclass whose annotations are numbers, text, None, enums, tuples, dictionaries or dataclasses.

    Raises:
        ValueError: A field holds something else; the message names it.
    """
    for name, hint in get_type_hints(type(record)).items():
        value = getattr(record, name)
        if not _fits(value, hint):
            shown = hint.__name__ if isinstance(hint, type) else str(hint)
            raise ValueError(f"{name} must be {shown}, got {str(value)[:60]!r}")


def _fits(value: Any, hint: Any) -> bool:
    kind, inner = get_origin(hint), get_args(hint)
    if hint is Any:
        return True
    if kind in (Union, UnionType):
        return any(_fits(value, each) for each in inner)
    if kind is tuple:
        if len(inner) == 2 and inner[1] is ...:
            return isinstance(value, tuple | list) and all(_fits(each, inner[0]) for each in value)
        return isinstance(value, tuple | list) and len(value) == len(inner) and all(map(_fits, value, inner))
    if kind in (dict, Mapping):
        return isinstance(value, dict) and all(
            _fits(key, inner[0]) and (each is None or _fits(each, inner[1])) for key, each in value.items()
        )
    if hint in (int, float):
        return isinstance(value, int if hint is int else int | float) and not isinstance(value, bool)
    if isinstance(hint, type) and is_dataclass(hint) and isinstance(value, hint):
        require_field_types(value)
        return True
    return isinstance(value, kind or hint)
