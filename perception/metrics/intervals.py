"""Confidence intervals of shares."""

import numpy as np

Z_95 = 1.959963984540054  # the normal distribution's 97.5 % quantile


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
