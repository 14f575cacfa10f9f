"""Generic damage: it never fails itself, mostly changes something, and is the same for the same seed."""

import json

import numpy as np
import pytest

from policies.soak.fuzz.damage import damaged_array, damaged_bytes, damaged_json, damaged_text

TEXT = "ply\nformat ascii 1.0\nelement vertex 3\n0.5 -1.25 7\n"
VALUE = {"K": [[300, 0, 79.5], [0, 300, 59.5]], "unit": {"name": "mm", "scale": 0.001}, "empty": []}
ARRAYS = (np.eye(4), np.zeros((3, 5), np.uint8), np.array("text"), np.array(2.5), np.zeros((0, 3), np.float32))


def test_bytes_are_damaged() -> None:
    for content in (b"", b"a", bytes(range(256))):
        made = [damaged_bytes(np.random.default_rng(k), content) for k in range(200)]
        assert made == [damaged_bytes(np.random.default_rng(k), content) for k in range(200)]
        assert len(set(made)) > 5
    assert sum(each != content for each in made) > 180


def test_text_is_damaged() -> None:
    made = [damaged_text(np.random.default_rng(k), TEXT) for k in range(200)]
    assert sum(each != TEXT for each in made) > 170
    assert any("nan" in each for each in made)
    assert damaged_text(np.random.default_rng(0), "") == ""


def test_values_are_damaged_at_any_depth() -> None:
    before = json.dumps(VALUE)
    made = [json.dumps(damaged_json(np.random.default_rng(k), VALUE)) for k in range(300)]
    assert sum(each != before for each in made) > 280
    assert json.dumps(VALUE) == before  # the input is as it was
    assert any('"name": null' in each for each in made)
    assert any("UNIT" in each for each in made)


@pytest.mark.parametrize("array", ARRAYS, ids=lambda array: f"{array.dtype}{array.shape}")
def test_arrays_are_damaged(array: np.ndarray) -> None:
    before = array.copy()
    made = [damaged_array(np.random.default_rng(k), array) for k in range(100)]
    assert len({(each.shape, each.dtype) for each in made}) > 3
    assert np.array_equal(array, before)
