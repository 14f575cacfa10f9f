"""Rates and means with 95 % intervals."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry import Floats, require_shape
from perception.metrics.average_precision import percentile_interval
from perception.metrics.intervals import wilson_interval

RESAMPLES = 2000
Interval = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Rate:
    """A share with its sample size and 95 % Wilson interval.

    Attributes:
        successes: Number of successes.
        n: Number of trials.
        low: Lower end of the interval.
        high: Upper end of the interval.
    """

    successes: int
    n: int
    low: float
    high: float

    @property
    def value(self) -> float | None:
        """The share itself; None without trials."""
        return self.successes / self.n if self.n else None


def rate(successes: int, n: int) -> Rate:
    """Return the pooled rate of ``successes`` in ``n`` trials with its 95 % Wilson interval."""
    low, high = wilson_interval(successes, n)
    return Rate(successes=successes, n=n, low=low, high=high)


def bootstrap_mean(values: ArrayLike, rng: np.random.Generator, resamples: int = RESAMPLES) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of the mean of (N,) values."""
    values = np.asarray(values, dtype=np.float64)
    return bootstrap_ratio(values, np.ones_like(values), rng, resamples)


FEWEST_BINS = 5  # number of bins from which an interval from resampling whole bins is shown


def bootstrap_ratio(
    numerators: ArrayLike, denominators: ArrayLike, rng: np.random.Generator, resamples: int = RESAMPLES
) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of sum(numerators) / sum(denominators), drawn in pairs.

    Deliveries over times [h], for example, give the interval of deliveries per hour.

    Args:
        numerators: (N,) values above the fraction bar.
        denominators: (N,) positive values below it.
        rng: Random numbers for the bootstrap.
        resamples: Number of bootstrap samples.

    Raises:
        ValueError: There is nothing to resample, the lengths differ or a denominator is not positive.

    Note:
        O(N resamples) time, O(N) memory.
    """
    pairs = _columns(numerators, denominators)
    if not np.all(pairs[:, 1] > 0):
        raise ValueError(f"denominators must be positive, got {pairs[:, 1].min()}")
    ratios = np.empty(resamples)
    for k in range(resamples):
        above, below = pairs[rng.integers(len(pairs), size=len(pairs))].sum(axis=0)
        ratios[k] = above / below
    low, high = np.percentile(ratios, [2.5, 97.5])
    return float(low), float(high)


def paired_difference(
    first: ArrayLike, second: ArrayLike, rng: np.random.Generator, resamples: int = RESAMPLES
) -> tuple[float, float, float]:
    """Return mean(first - second) and its 95 % percentile bootstrap interval.

    Args:
        first: (N,) results of one policy.
        second: (N,) results of another policy on the same seeds.
        rng: Random numbers for the bootstrap.
        resamples: Number of bootstrap samples.

    Returns:
        Difference, lower and upper end of its interval.

    Raises:
        ValueError: There is nothing to resample, or the lengths differ.
    """
    pairs = _columns(first, second)
    differences = pairs[:, 0] - pairs[:, 1]
    return float(differences.mean()), *bootstrap_mean(differences, rng, resamples)


def paired_ratio_difference(
    first: ArrayLike, second: ArrayLike, rng: np.random.Generator, resamples: int = RESAMPLES
) -> tuple[float, float, float]:
    """Return the difference of two pooled ratios, first - second, and its 95 % percentile bootstrap interval.

    Unlike the mean of the bins' differences, this is the difference of the two printed rates, and a bin in which one of
    the two attempted nothing counts.

    Args:
        first: (N, 2) numerator and denominator of each bin under one condition.
        second: (N, 2) numerator and denominator of the same bins under the other; each bin is drawn with both.
        rng: Random numbers for the bootstrap.
        resamples: Number of bootstrap samples; those in which a denominator is 0 are left out.

    Returns:
        Difference, lower and upper end of its interval; NaN where the sum of a denominator is 0. A single bin has no
        interval: its ends are NaN.

    Raises:
        ValueError: There is nothing to resample, the lengths differ or a denominator is negative.
    """
    both = np.stack([np.asarray(each, np.float64).reshape(-1, 2) for each in _same_shape(first, second)])
    if np.any(both[:, :, 1] < 0):
        raise ValueError(f"denominators must not be negative, got {both[:, :, 1].min()}")
    count = both.shape[1]
    value = float(_ratio_differences(both, np.ones((1, count)))[0])
    if count < 2:
        return value, np.nan, np.nan
    weights = rng.multinomial(count, np.full(count, 1.0 / count), size=resamples).astype(np.float64)
    return value, *percentile_interval(_ratio_differences(both, weights))


def _ratio_differences(both: Floats, weights: Floats) -> Floats:
    """Return the (R,) differences of the ratios of (2, N, 2) pairs, each bin weighted by (R, N) ``weights``."""
    sums = weights @ both  # (2, R, 2)
    above, below = sums[:, :, 0], sums[:, :, 1]
    ratios = np.divide(above, below, out=np.full(above.shape, np.nan), where=below > 0)
    differences: Floats = ratios[0] - ratios[1]
    return differences


def _same_shape(first: ArrayLike, second: ArrayLike) -> tuple[Floats, Floats]:
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if a.shape != b.shape:
        raise ValueError(f"both samples must have one length, got {a.shape} and {b.shape}")
    if len(a) == 0:
        raise ValueError("there is nothing to resample: the samples are empty")
    return a, b


def _columns(first: ArrayLike, second: ArrayLike) -> Floats:
    a, b = _same_shape(first, second)
    require_shape("first", a, (None,))
    return np.column_stack([a, b])
