"""Generic damage to bytes, text, JSON values and arrays: what broken disks, other tools and tired users do to files."""

import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

NUMBERS = ("nan", "inf", "-inf", "-1", "0", "1e30", "-1e30", "99999999999", "4294967296", "0.5", "1e-30", "seven", "")
VALUES: tuple[Any, ...] = (None, True, -1, 0, 1e30, float("nan"), 10**12, "", "seven", [], [1, [2]], {}, {"a": 1}, 0.5)
_DTYPES = (np.float16, np.float32, np.float64, np.int8, np.uint8, np.int64, np.uint16, np.bool_, np.complex128, np.str_)
_Array = NDArray[Any]


def choose(rng: np.random.Generator, choices: Sequence[Any]) -> Any:
    """Return one of the choices, as it is."""
    return choices[int(rng.integers(len(choices)))]


def damaged_bytes(rng: np.random.Generator, content: bytes) -> bytes:
    """Return bytes with one kind of damage: cut, flipped, repeated, moved, emptied, or with another beginning."""
    size = len(content)
    a, b = sorted(int(each) for each in rng.integers(0, size + 1, 2))
    match int(rng.integers(8)):
        case 0:
            return content[:a]
        case 1:
            flipped = np.frombuffer(content, np.uint8).copy()
            places = rng.integers(0, max(size, 1), min(size, 8))
            flipped[places] ^= rng.integers(1, 256, len(places)).astype(np.uint8)
            return flipped.tobytes()
        case 2:
            return content[:a] + content[b:]
        case 3:
            return content[:b] + content[a:]
        case 4:
            return content[b:] + content[:b]
        case 5:
            return content[:a] + bytes(b - a) + content[b:]
        case 6:
            return rng.bytes(int(rng.integers(1, 9))) + content[8:]
        case _:
            others = (b"", b"\0" * 64, rng.bytes(256), b"PK\x03\x04" + content, content + rng.bytes(33))
            return others[int(rng.integers(len(others)))]


def damaged_text(rng: np.random.Generator, text: str) -> str:
    """Return text with some numbers, words or lines replaced, lost, doubled or swapped."""
    for _ in range(int(rng.integers(1, 4))):
        text = choose(rng, (_other_number, _other_word, _other_lines))(rng, text)
    return text


def damaged_json(rng: np.random.Generator, value: Any) -> Any:
    """Return a JSON value in which one to three nested values are replaced, lost, renamed or doubled."""
    for _ in range(int(rng.integers(1, 4))):
        value = _other_value(rng, value)
    return value


def damaged_array(rng: np.random.Generator, array: _Array) -> _Array:
    """Return an array with another type, shape, unit or order, or with values that mean nothing."""
    if array.dtype.kind not in "biufc":
        others: tuple[_Array, ...] = (np.array("teapot"), np.array(-1), np.array(1e30), array[None], np.zeros(0))
        return others[int(rng.integers(len(others)))]
    kinds: Sequence[Callable[[], _Array]] = (
        lambda: array.astype(choose(rng, _DTYPES)),
        lambda: np.asarray(array, np.float64) * choose(rng, (1000, 0.001, -1, 0, 1e20, np.nan, np.inf)),
        lambda: array.T,
        lambda: array[..., None],
        lambda: array.reshape(-1),
        lambda: array[: int(rng.integers(0, len(array) + 1))] if array.ndim else array,
        lambda: np.concatenate([array, array]) if array.ndim else array,
        lambda: _with_holes(rng, array),
        lambda: np.zeros((0,) * array.ndim, array.dtype),
        lambda: np.zeros(array.shape, array.dtype),
        lambda: rng.normal(size=array.shape),
        lambda: np.flip(array),
    )
    with np.errstate(all="ignore"):
        damaged: _Array = choose(rng, kinds)()
    return damaged


def _with_holes(rng: np.random.Generator, array: _Array) -> _Array:
    values = np.array(array, np.float64)
    values[rng.random(values.shape) < 0.2] = choose(rng, (np.nan, np.inf, -np.inf, -1.0, 1e30))
    return values


def _other_number(rng: np.random.Generator, text: str) -> str:
    found = list(re.finditer(r"-?\d+(\.\d+)?(e[+-]?\d+)?", text))
    if not found:
        return text
    number = choose(rng, found)
    return f"{text[: number.start()]}{choose(rng, NUMBERS)}{text[number.end() :]}"


def _other_word(rng: np.random.Generator, text: str) -> str:
    found = list(re.finditer(r"[A-Za-z_]+", text))
    if not found:
        return text
    word, other = choose(rng, found), choose(rng, found)
    instead = choose(rng, ("", "teapot", other[0], word[0].upper()))
    return f"{text[: word.start()]}{instead}{text[word.end() :]}"


def _other_lines(rng: np.random.Generator, text: str) -> str:
    lines = text.splitlines(keepends=True)
    if not lines:
        return text
    a, b = (int(each) for each in rng.integers(0, len(lines), 2))
    match int(rng.integers(3)):
        case 0:
            del lines[a]
        case 1:
            lines.insert(a, lines[b])
        case _:
            lines[a], lines[b] = lines[b], lines[a]
    return "".join(lines)


def _other_value(rng: np.random.Generator, value: Any) -> Any:
    """Return a JSON value with one change, at a random depth."""
    deeper = isinstance(value, dict | list) and len(value) > 0 and rng.random() < 0.85
    if not deeper:
        return choose(rng, VALUES)
    if isinstance(value, list):
        k = int(rng.integers(len(value)))
        return choose(rng, (value[:k], value + value[k:], [*value[:k], _other_value(rng, value[k]), *value[k + 1 :]]))
    name = choose(rng, list(value))
    others = {key: each for key, each in value.items() if key != name}
    changed = _other_value(rng, value[name])
    return choose(rng, (others, {**others, name.upper(): value[name]}, *[{**value, name: changed}] * 4))
