"""Intervals of shares."""

import pytest

from perception.metrics.intervals import wilson_interval


def test_wilson_at_the_ends_and_in_the_middle() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)
    assert wilson_interval(0, 10)[0] == 0.0
    assert wilson_interval(10, 10)[1] == 1.0
    assert wilson_interval(5, 10) == pytest.approx((0.2366, 0.7634), abs=1e-4)


@pytest.mark.parametrize("counts", [(-1, 3), (4, 3)])
def test_impossible_counts_are_refused(counts: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match=rf"successes must be in 0\.\.n, got {counts[0]} of {counts[1]}"):
        wilson_interval(*counts)
