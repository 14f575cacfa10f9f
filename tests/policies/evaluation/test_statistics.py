import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perception.metrics.intervals import wilson_interval
from policies.evaluation.statistics import (
    bootstrap_mean,
    bootstrap_ratio,
    paired_difference,
    paired_ratio_difference,
    rate,
)


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [
        (5, 10, 0.2366, 0.7634),  # worked by hand: centre 0.5, half 1.96 sqrt(0.025 + 0.0096) / 1.384
        (0, 10, 0.0, 0.2775),  # z^2 / (n + z^2)
        (10, 10, 0.7225, 1.0),
        (81, 263, 0.2553, 0.3662),  # Newcombe, Statistics in Medicine 17 (1998), table I
        (15, 148, 0.0624, 0.1605),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_agrees_with_published_values(successes: int, n: int, low: float, high: float) -> None:
    assert wilson_interval(successes, n) == pytest.approx((low, high), abs=6e-5)


def test_without_trials_everything_is_possible() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)
    assert rate(0, 0).value is None


@given(st.integers(0, 10_000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_contains_the_estimate_within_zero_and_one(counts: tuple[int, int]) -> None:
    successes, n = counts
    low, high = wilson_interval(successes, n)
    assert 0.0 <= low < high <= 1.0
    if n:
        assert low <= successes / n <= high


@given(st.integers(1, 1000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_is_symmetric_and_narrows(counts: tuple[int, int]) -> None:
    successes, n = counts
    low, high = wilson_interval(successes, n)
    assert wilson_interval(n - successes, n) == pytest.approx((1 - high, 1 - low))
    more_low, more_high = wilson_interval(4 * successes, 4 * n)
    assert more_high - more_low < high - low


@pytest.mark.parametrize("counts", [(3, 2), (-1, 2)])
def test_impossible_counts_are_refused(counts: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match=r"successes must be in 0\.\.n, got"):
        wilson_interval(*counts)


def test_the_bootstrap_of_a_constant_is_a_point() -> None:
    assert bootstrap_mean([2.5] * 7, np.random.default_rng(0)) == (2.5, 2.5)


def test_the_bootstrap_of_a_mean_agrees_with_the_normal_interval() -> None:
    values = np.random.default_rng(3).normal(10.0, 2.0, size=400)
    low, high = bootstrap_mean(values, np.random.default_rng(0))
    half = 1.96 * values.std() / np.sqrt(len(values))
    assert (low, high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.1 * half)


def test_a_ratio_is_of_sums_and_not_a_mean_of_ratios() -> None:
    low, high = bootstrap_ratio([1, 0] * 300, [1.0, 3.0] * 300, np.random.default_rng(0))
    assert low < 0.25 < high
    assert high - low < 0.1


def test_the_bootstrap_repeats_with_its_generator() -> None:
    values = [1.0, 2.0, 5.0]
    assert bootstrap_mean(values, np.random.default_rng(4)) == bootstrap_mean(values, np.random.default_rng(4))


def test_pairing_removes_what_the_seeds_have_in_common() -> None:
    rng = np.random.default_rng(0)
    common = rng.normal(size=60)
    first, second = common + 0.2 + 0.01 * rng.normal(size=60), common
    difference, low, high = paired_difference(first, second, rng)
    assert difference == pytest.approx(0.2, abs=0.01)
    assert 0.19 < low <= difference <= high < 0.21


def test_equal_policies_differ_by_nothing() -> None:
    assert paired_difference([1, 0, 1], [1, 0, 1], np.random.default_rng(0)) == (0.0, 0.0, 0.0)


def test_what_cannot_be_resampled_is_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="nothing to resample"):
        bootstrap_mean([], rng)
    with pytest.raises(ValueError, match="one length"):
        paired_difference([1, 2], [1], rng)
    with pytest.raises(ValueError, match="denominators must be positive, got 0"):
        bootstrap_ratio([1, 2], [1, 0], rng)


def test_a_paired_difference_of_ratios_is_that_of_the_pooled_ratios() -> None:
    # 3 of 4 and 1 of 10 against 2 of 4 and 5 of 10; the mean of the bins' differences would be -0.075.
    difference, low, high = paired_ratio_difference([(3, 4), (1, 10)], [(2, 4), (5, 10)], np.random.default_rng(0))
    assert difference == pytest.approx(4 / 14 - 7 / 14)
    assert (low, high) == pytest.approx((1 / 10 - 5 / 10, 3 / 4 - 2 / 4))  # of two bins every fourth draw is one twice


def test_a_bin_without_trials_on_one_side_counts_on_the_other() -> None:
    difference, low, high = paired_ratio_difference([(0, 0), (1, 2)], [(1, 1), (1, 1)], np.random.default_rng(0))
    assert difference == -0.5
    assert (low, high) == (-0.5, -0.5)  # draws of the first bin alone have no ratio, and are left out


def test_ratios_that_do_not_exist_have_no_difference() -> None:
    rng = np.random.default_rng(0)
    assert np.isnan(paired_ratio_difference([(0, 0), (0, 0)], [(1, 1), (1, 1)], rng)).all()
    difference, low, high = paired_ratio_difference([(1, 2)], [(1, 4)], rng)
    assert difference == 0.25
    assert np.isnan([low, high]).all()  # one bin says nothing about bins


def test_the_interval_of_a_paired_difference_of_ratios_covers_and_pairs() -> None:
    rng = np.random.default_rng(1)
    hard = rng.uniform(0.3, 0.9, 60)  # bins differ much; both ways of picking suffer alike
    first = np.column_stack([100 * hard, np.full(60, 100)])
    second = np.column_stack([100 * (hard - 0.1) + rng.normal(0, 1, 60), np.full(60, 100)])
    difference, low, high = paired_ratio_difference(first, second, rng)
    half = 1.96 * (first - second)[:, 0].std() / 100 / np.sqrt(60)
    assert (low, high) == pytest.approx((difference - half, difference + half), abs=0.2 * half)


def test_unequal_or_impossible_ratios_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="one length"):
        paired_ratio_difference([(1, 2)], [(1, 2), (1, 2)], rng)
    with pytest.raises(ValueError, match="nothing to resample"):
        paired_ratio_difference([], [], rng)
    with pytest.raises(ValueError, match="denominators must not be negative, got -2"):
        paired_ratio_difference([(1, 2)], [(1, -2)], rng)
