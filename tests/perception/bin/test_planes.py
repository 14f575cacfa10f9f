"""Peaks of heights: where many points lie, whatever lies far away."""

import numpy as np
import pytest

from perception.bin.planes import peaks
from perception.geometry import Floats


def heights(seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.normal(0.0, 0.0005, 600), rng.normal(0.1, 0.0005, 300), rng.uniform(-0.05, 0.15, 100)])


def test_peaks_are_the_levels_with_most_points_first() -> None:
    assert peaks(heights(), 0.002, 0.05) == pytest.approx([0.0, 0.1], abs=0.002)


@pytest.mark.parametrize("far", [-1e6, 1e6, -1e9])
def test_absurd_heights_move_no_peak_and_need_no_memory_for_what_lies_between(far: float) -> None:
    found = peaks(np.append(heights(), far), 0.002, 0.05)
    assert found == pytest.approx(peaks(heights(), 0.002, 0.05), abs=0.002)


def test_two_levels_far_apart_are_both_peaks() -> None:
    both = np.concatenate([heights(), heights(1) + 5e5])
    assert sorted(peaks(both, 0.002, 0.05)[:2]) == pytest.approx([0.0, 5e5], abs=0.003)


def test_no_heights_have_no_peaks() -> None:
    assert len(peaks(np.zeros(0), 0.002, 0.05)) == 0
