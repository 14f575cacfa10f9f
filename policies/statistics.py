"""Rates and means with intervals: what stands beside every number that is printed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry import Floats, require_shape

Z_95 = 1.959963984540054  # the normal distribution's 97.5 % quantile
RESAMPLES = 2000


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


def wilson_interval(successes: int, n: int, z: float = Z_95) -> tuple[float, float]:
    """Return Wilson's score interval of a binomial share.

    Source: Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22 (1927).

    Args:
        successes: Number of successes, 0 to n.
        n: Number of trials; without any, the interval is (0, 1).
        z: Quantile of the normal distribution; 1.96 gives 95 %.

    Raises:
        ValueError: The counts are impossible.
    """
    if not 0 <= successes <= n:
        raise ValueError(f"successes must be in 0..n, got {successes} of {n}")
    if n == 0:
        return 0.0, 1.0
    share = successes / n
    shrink = 1.0 / (1.0 + z * z / n)
    centre = shrink * (share + z * z / (2 * n))
    half = shrink * z * np.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    # Exactly 0 and 1 at the ends, where rounding would leave the estimate just outside.
    low = 0.0 if successes == 0 else float(max(centre - half, 0.0))
    high = 1.0 if successes == n else float(min(centre + half, 1.0))
    return low, high


def bootstrap_mean(values: ArrayLike, rng: np.random.Generator, resamples: int = RESAMPLES) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of the mean of (N,) values."""
    values = np.asarray(values, dtype=np.float64)
    return bootstrap_ratio(values, np.ones_like(values), rng, resamples)


def bootstrap_ratio(
    numerators: ArrayLike, denominators: ArrayLike, rng: np.random.Generator, resamples: int = RESAMPLES
) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of sum(numerators) / sum(denominators) over N paired draws.

    With deliveries above and times [h] below it is that of deliveries an hour.

    Args:
        numerators: (N,).
        denominators: (N,) positive.
        rng: The resampling's chance.
        resamples: Number of bootstrap samples.

    Raises:
        ValueError: There is nothing to resample, the lengths differ or a denominator is not positive.

    Note: O(N resamples) time, O(N) memory a resample.
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
    """Return mean(first - second) and its 95 % percentile bootstrap interval, for two policies on the same (N,) seeds.

    Raises:
        ValueError: There is nothing to resample, or the lengths differ.
    """
    pairs = _columns(first, second)
    differences = pairs[:, 0] - pairs[:, 1]
    return float(differences.mean()), *bootstrap_mean(differences, rng, resamples)


def _columns(first: ArrayLike, second: ArrayLike) -> Floats:
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    require_shape("first", a, (None,))
    if a.shape != b.shape:
        raise ValueError(f"both samples must have one length, got {a.shape} and {b.shape}")
    if len(a) == 0:
        raise ValueError("there is nothing to resample: the samples are empty")
    return np.column_stack([a, b])
