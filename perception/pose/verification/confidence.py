"""Calibrated scores: the probability that a pose is right, by logistic regression."""

from dataclasses import dataclass

import numpy as np

from perception.pose.verification.verification import Verdict


@dataclass(frozen=True, kw_only=True)
class ConfidenceConfig:
    """Coefficients of a logistic regression, fitted by `scripts/calibrate_poses.py`; BENCHMARK.md says how well.

    Attributes:
        bias: Constant term.
        edge_score: Coefficient of the verdict's edge score.
        support: Coefficient of the verdict's support.
        violation: Coefficient of the verdict's violation.
        margin: Coefficient of the clipped margin over the best different pose.
        score_drop: Coefficient of the clipped score drop under perturbation.
        size: Coefficient of the natural logarithm of the number of boundary points of the group after thinning.
        clear: Limit to which margin and score drop are clipped, in units of the logit.
    """

    bias: float = -8.32
    edge_score: float = 2.33
    support: float = 2.04
    violation: float = -2.99
    margin: float = 0.88
    score_drop: float = 0.98
    size: float = 1.06
    clear: float = 3.0

    def __post_init__(self) -> None:
        for name in ("bias", "edge_score", "support", "violation", "margin", "score_drop", "size"):
            if not np.isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be finite, got {getattr(self, name)}")
        if not 0 < self.clear < np.inf:
            raise ValueError(f"clear must be positive, got {self.clear}")


def confidence(
    verdict: Verdict, margin: float, score_drop: float, size: int, config: ConfidenceConfig | None = None
) -> float:
    """Return the probability that a pose is right, in [0, 1].

    Args:
        verdict: Agreement of the pose with the boundary points and the depth image.
        margin: Difference between the logit of the pose and that of the best different one; infinite if there is none.
        score_drop: Smallest decrease of the logit under small rotations; infinite if there are none.
        size: Number of boundary points of the group after thinning.
        config: Coefficients; the defaults of :class:`ConfidenceConfig` if None.

    Raises:
        ValueError: ``size`` is not positive, or ``margin`` or ``score_drop`` is NaN.
    """
    config = config or ConfidenceConfig()
    if size < 1:
        raise ValueError(f"size must be at least 1, got {size}")
    for name, value in (("margin", margin), ("score_drop", score_drop)):
        if np.isnan(value):
            raise ValueError(f"{name} must not be NaN, got {value}")
    weighted = config.bias + float(
        np.dot(coefficients(config), predictors(verdict, margin, score_drop, size, config.clear))
    )
    return float(0.5 * (1 + np.tanh(weighted / 2)))


def predictors(verdict: Verdict, margin: float, score_drop: float, size: int, clear: float) -> tuple[float, ...]:
    """Return the predictors of the regression, in the order of :func:`coefficients`."""
    clipped = (min(max(value, -clear), clear) for value in (margin, score_drop))
    return verdict.edge_score, verdict.support, verdict.violation, *clipped, float(np.log(size))


def coefficients(config: ConfidenceConfig) -> tuple[float, ...]:
    """Return the coefficients of the regression without the bias."""
    return config.edge_score, config.support, config.violation, config.margin, config.score_drop, config.size
