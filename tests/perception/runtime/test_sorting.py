"""Distinct integers, with NumPy as the oracle."""

import numpy as np
import pytest

from perception.runtime.sorting import distinct


@pytest.mark.parametrize("count", [0, 1, 2, 1000])
@pytest.mark.parametrize("largest", [1, 50, 2**62])
def test_distinct_integers_are_those_of_numpy(count: int, largest: int) -> None:
    values = np.random.default_rng(count).integers(-largest, largest, count)
    given = values.copy()
    assert np.array_equal(distinct(values), np.unique(values))
    assert np.array_equal(values, given)
