import numpy as np
import pytest

from policies.benchmarks.builds.paired import PairedTimes, median_interval


def times(before: tuple[float, ...], after: tuple[float, ...]) -> PairedTimes:
    return PairedTimes(name="frame", unit="ms", before=before, after=after)


def test_the_ratio_is_the_median_of_those_of_the_pairs() -> None:
    row = times((10.0, 30.0, 100.0), (10.0, 10.0, 20.0))
    assert row.ratio == 3  # and neither 10 by 10, that of the medians, nor their sum's 3.5
    assert row.interval is None


def test_the_interval_lies_between_ordered_values() -> None:
    rng = np.random.default_rng(0)
    for n, rank in ((6, 1), (8, 1), (9, 2), (12, 3), (40, 14)):  # those of the sign test's tables
        values = rng.permutation(np.arange(1.0, n + 1))
        assert median_interval(values) == (rank, n + 1 - rank)
    assert median_interval(np.arange(5.0)) is None


def test_the_interval_holds_the_median_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    bounds = [median_interval(values) or (0.0, 0.0) for values in rng.exponential(size=(2000, 12))]
    held = np.mean([low <= np.log(2) <= high for low, high in bounds])
    assert 0.95 < held < 0.975  # exactly 0.9614


def test_times_come_in_pairs() -> None:
    with pytest.raises(ValueError, match="'frame' needs as many times before as after, at least one, got 1 and 2"):
        times((1.0,), (1.0, 2.0))
    with pytest.raises(ValueError, match="at least one, got 0 and 0"):
        times((), ())
