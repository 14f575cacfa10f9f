"""How sure a pose is: what speaks for it, how much less speaks for any other pose, and how much there was to see."""

from dataclasses import dataclass

import numpy as np

from perception.pose.verification import Verdict


@dataclass(frozen=True, kw_only=True)
class ConfidenceConfig:
    """Coefficients of a logistic regression, fitted by `scripts/calibrate_poses.py`; see BENCHMARK.md for how well."""

    bias: float = -10.247
    edge_score: float = 3.419
    explained: float = 1.894
    support: float = 1.524
    violation: float = -3.511
    margin: float = 1.358
    size: float = 1.324  # of the logarithm of the group's thinned boundary points
    clear: float = 3.0  # a larger margin counts no more

    def __post_init__(self) -> None:
        for name in ("bias", "edge_score", "explained", "support", "violation", "margin", "size"):
            if not np.isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be finite, got {getattr(self, name)}")
        if not 0 < self.clear < np.inf:
            raise ValueError(f"clear must be positive, got {self.clear}")


def confidence(verdict: Verdict, margin: float, size: int, config: ConfidenceConfig | None = None) -> float:
    """Return the chance that a pose is right, in [0, 1].

    Args:
        verdict: On the pose.
        margin: By how much its evidence exceeds that of the best pose that differs from it; infinite without one.
        size: Boundary points of its group, thinned.
        config: :class:`ConfidenceConfig`'s defaults if left out.

    Raises:
        ValueError: ``size`` is not positive, or ``margin`` is NaN.
    """
    config = config or ConfidenceConfig()
    if size < 1 or np.isnan(margin):
        raise ValueError(f"size must be at least 1 and margin a number, got {size} and {margin}")
    weighted = config.bias + float(np.dot(coefficients(config), predictors(verdict, margin, size, config.clear)))
    return float(0.5 * (1 + np.tanh(weighted / 2)))


def predictors(verdict: Verdict, margin: float, size: int, clear: float) -> tuple[float, ...]:
    """Return what the regression is over, in the order of :func:`coefficients`."""
    clipped = min(max(margin, -clear), clear)
    return verdict.edge_score, verdict.explained, verdict.support, verdict.violation, clipped, float(np.log(size))


def coefficients(config: ConfidenceConfig) -> tuple[float, ...]:
    """Return the coefficients without the bias."""
    return config.edge_score, config.explained, config.support, config.violation, config.margin, config.size
