"""Times of two builds on the same inputs, and their ratio."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import binom

from perception.geometry import Floats


@dataclass(frozen=True, kw_only=True)
class PairedTimes:
    """Times of one quantity, one pair for each input.

    Attributes:
        name: What was timed.
        unit: Unit of the times.
        before: Times of the other build.
        after: Times of this build on the same inputs.
    """

    name: str
    unit: str
    before: tuple[float, ...]
    after: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.before) != len(self.after) or not self.before:
            raise ValueError(
                f"{self.name!r} needs as many times before as after, at least one, "
                f"got {len(self.before)} and {len(self.after)}"
            )

    @property
    def ratio(self) -> float:
        """Median over the inputs of the time before by the time after, where 3 means three times as fast."""
        return float(np.median(self._ratios()))

    @property
    def interval(self) -> tuple[float, float] | None:
        """Interval of the ratio's median at 95 %; None for fewer than six inputs, which cannot give one."""
        return median_interval(self._ratios())

    def _ratios(self) -> Floats:
        before, after = np.array(self.before), np.array(self.after)
        ratios: Floats = before / np.maximum(after, 1e-9)
        return ratios


def median_interval(values: Floats, level: float = 0.95) -> tuple[float, float] | None:
    """Return the interval between two of the values that holds the median of their distribution.

    It assumes nothing of the distribution: each value is below the median with probability one half.

    Args:
        values: (N,) independent values.
        level: Probability with which the interval holds the median, at least.

    Returns:
        Lower and upper bound; None if even the extremes would hold the median less often.
    """
    rank = int(binom.ppf((1 - level) / 2, len(values), 0.5))  # values below and above which lie outside
    if rank < 1:
        return None
    ordered = np.sort(values)
    return float(ordered[rank - 1]), float(ordered[-rank])
