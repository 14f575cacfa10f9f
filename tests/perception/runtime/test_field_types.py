"""The fields of records that were made from files."""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Literal

import numpy as np
import pytest

from perception.runtime.field_types import require_field_types, require_finite


class Word(StrEnum):
    GOOD = "good"


@dataclass(frozen=True)
class Inner:
    width: float


@dataclass(frozen=True)
class Outer:
    count: int = 1
    wall: float = 2
    name: str = ""
    word: Word | None = None
    inner: tuple[Inner, ...] = (Inner(0.5),)
    pair: tuple[int, float] = (1, 0.5)
    features: dict[str, float] = field(default_factory=dict)
    flag: bool = True
    anything: Any = None
    choice: Literal["a", "b"] | None = None


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"wall": 3, "word": Word.GOOD, "inner": (), "features": {"a": 1, "b": None}, "anything": []},
        {"inner": (Inner(float("nan")),), "pair": [1, 2]},
        {"count": np.int64(3), "wall": np.float32(0.5), "pair": np.array([1, 2])},
        {"choice": "c"},  # its own check names the words
    ],
)
def test_fields_that_fit_pass(values: dict[str, Any]) -> None:
    require_field_types(replace(Outer(), **values))


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"count": None}, "count must be int, got None"),
        ({"count": 1.5}, "count must be int, got 1.5"),
        ({"count": True}, "count must be int, got True"),
        ({"wall": None}, "wall must be float, got None"),
        ({"name": 3}, "name must be str, got 3"),
        ({"word": "good?"}, r"word must be .*Word \| None, got 'good\?'"),
        ({"pair": (1,)}, r"pair must be tuple\[int, float\], got \(1,\)"),
        ({"pair": np.array(1.5)}, r"pair must be tuple\[int, float\], got array\(1.5\)"),
        ({"pair": 0.5}, r"pair must be tuple\[int, float\], got 0.5"),
        ({"features": {"a": "b"}}, "features must be dict"),
        ({"features": []}, "features must be dict"),
        ({"inner": ({"width": 1},)}, "inner must be tuple"),
        ({"inner": (Inner("wide"),)}, "width must be float, got 'wide'"),  # type: ignore[arg-type]
        ({"flag": 1}, "flag must be bool, got 1"),
    ],
)
def test_fields_that_do_not_are_named(values: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        require_field_types(replace(Outer(), **values))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -np.inf])
def test_numbers_that_are_not_finite_are_named(value: float) -> None:
    require_finite(Outer())
    with pytest.raises(ValueError, match=r"wall must be finite, got -?(nan|inf)"):
        require_finite(Outer(wall=value))
    with pytest.raises(ValueError, match=r"pair must be finite, got \(1, -?(nan|inf)\)"):
        require_finite(Outer(pair=(1, value)))
