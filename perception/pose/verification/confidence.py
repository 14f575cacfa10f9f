"""How sure a pose is: what speaks for it, how much less for other poses, and how much there was to see."""

from dataclasses import dataclass

import numpy as np

from perception.pose.verification.verification import Verdict


@dataclass(frozen=True, kw_only=True)
class ConfidenceConfig:
    """Coefficients of a logistic regression, fitted by `scripts/calibrate_poses.py`; see BENCHMARK.md for how well."""

    bias: float = -8.32
    edge_score: float = 2.33
    support: float = 2.04
    violation: float = -2.99
    margin: float = 0.88
    firmness: float = 0.98
    size: float = 1.06  # of the logarithm of the group's thinned boundary points
    clear: float = 3.0  # a larger margin, or a larger fall of the evidence, counts no more

    def __post_init__(self) -> None:
        for name in ("bias", "edge_score", "support", "violation", "margin", "firmness", "size"):
            if not np.isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be finite, got {getattr(self, name)}")
        if not 0 < self.clear < np.inf:
            raise ValueError(f"clear must be positive, got {self.clear}")


def confidence(
    verdict: Verdict, margin: float, firmness: float, size: int, config: ConfidenceConfig | None = None
) -> float:
    """Return the chance that a pose is right, in [0, 1].

    Args:
        verdict: On the pose.
        margin: By how much its evidence exceeds that of the best pose that differs from it; infinite without one.
        firmness: By how much its evidence exceeds that of the same pose turned a little.
        size: Boundary points of its group, thinned.
        config: :class:`ConfidenceConfig`'s defaults if left out.

    Raises:
        ValueError: ``size`` is not positive, or ``margin`` or ``firmness`` is NaN.
    """
    config = config or ConfidenceConfig()
    if size < 1 or np.isnan(margin) or np.isnan(firmness):
        raise ValueError(f"size must be at least 1, margin and firmness numbers, got {size}, {margin} and {firmness}")
    weighted = config.bias + float(
        np.dot(coefficients(config), predictors(verdict, margin, firmness, size, config.clear))
    )
    return float(0.5 * (1 + np.tanh(weighted / 2)))


def predictors(verdict: Verdict, margin: float, firmness: float, size: int, clear: float) -> tuple[float, ...]:
    """Return what the regression is over, in the order of :func:`coefficients`."""
    leads = (min(max(lead, -clear), clear) for lead in (margin, firmness))
    return verdict.edge_score, verdict.support, verdict.violation, *leads, float(np.log(size))


def coefficients(config: ConfidenceConfig) -> tuple[float, ...]:
    """Return the coefficients without the bias."""
    return config.edge_score, config.support, config.violation, config.margin, config.firmness, config.size
