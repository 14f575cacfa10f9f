"""Calibrated scores: the probability that a pose is right, by logistic regression."""

from dataclasses import dataclass

import numpy as np

from perception.geometry import Floats
from perception.pose.verification.mismatch import Mismatch
from perception.pose.verification.verification import Verdict

COEFFICIENTS = (
    "edge_score",
    "support",
    "violation",
    "margin",
    "close_margin",
    "score_drop",
    "close_score_drop",
    "size",
    "rotation_error",
)


@dataclass(frozen=True, kw_only=True)
class ConfidenceConfig:
    """Coefficients of a logistic regression, fitted by `scripts/calibrate_poses.py`; BENCHMARK.md says how well.

    Those of the first eight predictors were fitted to good frames. The coefficient of the expected error and the weight
    of the noise were then chosen, and the bias raised by 0.5, on scenes of four sensors.

    Attributes:
        bias: Constant term.
        edge_score: Coefficient of the verdict's edge score.
        support: Coefficient of the verdict's support.
        violation: Coefficient of the verdict's violation.
        margin: Coefficient of the margin over the best different pose, clipped to ``clear``.
        close_margin: Coefficient of the same margin, clipped to ``close``: of two poses that agree with the scene
            nearly alike, each may be right.
        score_drop: Coefficient of the score drop under perturbation, clipped to ``clear``.
        close_score_drop: Coefficient of the same score drop, clipped to ``close``.
        size: Coefficient of the natural logarithm of the number of boundary points of the group after thinning.
        rotation_error: Coefficient of the expected error of the rotation beyond ``exact``, up to ``unknown`` [1/rad].
        clear: Margin and score drop beyond which more of them says nothing, in units of the logit.
        close: Margin and score drop up to which little more of them says much, in units of the logit.
        exact: Expected error of the rotation up to which it says nothing [rad].
        unknown: Expected error of the rotation beyond which more of it says nothing [rad].
        patch: Number of samples up to which a patch that the camera saw through says nothing.
        patch_weight: Coefficient of each further sample of such a patch.
        stray: Share of the group's boundary points off the part, before its surface, up to which they say nothing.
        stray_weight: Coefficient of a larger share of them.
        noise: Standard deviation of the frame's depth up to which it says nothing [m]. It is a median over the bin:
            small round parts count as noise where they cover all of it.
        noise_weight: Coefficient of more noise [1/m]. Noise shifts the other predictors, so that a score fitted to good
            frames would promise too much.

    The last six are not part of the regression. Of the right poses of tees, 99 in 100 have a patch of at most 5 samples
    and a share of at most 0.02. Beyond these limits the coefficients soon make a sure pose an unlikely one.
    """

    bias: float = -6.018
    edge_score: float = 1.514
    support: float = 1.929
    violation: float = -5.421
    margin: float = 0.385
    close_margin: float = 2.821
    score_drop: float = 0.289
    close_score_drop: float = 1.225
    size: float = 0.533
    rotation_error: float = -38.2
    clear: float = 3.0
    close: float = 1.0
    exact: float = float(np.deg2rad(1.35))
    unknown: float = float(np.deg2rad(15.0))
    patch: float = 5.0
    patch_weight: float = -0.6
    stray: float = 0.03
    stray_weight: float = -40.0
    noise: float = 0.0010
    noise_weight: float = -1000.0

    def __post_init__(self) -> None:
        for name in ("bias", *COEFFICIENTS):
            if not np.isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be finite, got {getattr(self, name)}")
        if not 0 < self.close < self.clear < np.inf:
            raise ValueError(f"0 < close < clear is required, got {self.close} and {self.clear}")
        if not 0 <= self.exact < self.unknown < np.inf:
            raise ValueError(f"0 <= exact < unknown is required, got {self.exact} and {self.unknown}")
        for name in ("patch", "stray", "noise"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
            if not -np.inf < getattr(self, f"{name}_weight") <= 0:
                raise ValueError(f"{name}_weight must be 0 or less, got {getattr(self, f'{name}_weight')}")


def confidence(
    verdict: Verdict,
    margin: float,
    score_drop: float,
    size: int,
    config: ConfidenceConfig | None = None,
    penalty: float = 0.0,
) -> float:
    """Return the probability that a pose is right, in [0, 1].

    Args:
        verdict: Agreement of the pose with the boundary points and the depth image.
        margin: Difference between the logit of the pose and that of the best different one; infinite if there is none.
        score_drop: Smallest decrease of the logit under small rotations; infinite if there are none.
        size: Number of boundary points of the group after thinning.
        config: Coefficients; the defaults of :class:`ConfidenceConfig` if None.
        penalty: Term that is added to the weighted sum; see :func:`mismatch_penalty` and :func:`error_penalty`.

    Raises:
        ValueError: ``size`` is not positive, or ``margin`` or ``score_drop`` is NaN.
    """
    config = config or ConfidenceConfig()
    if size < 1:
        raise ValueError(f"size must be at least 1, got {size}")
    for name, value in (("margin", margin), ("score_drop", score_drop)):
        if np.isnan(value):
            raise ValueError(f"{name} must not be NaN, got {value}")
    verdicts = np.array([[verdict.edge_score, verdict.support, verdict.violation]])
    exact = np.zeros(1)  # the expected error is in the penalty
    found = predictors(verdicts, np.array([margin]), np.array([score_drop]), np.array([size]), exact, config)
    return float(confidences(found, config, penalty)[0])


def mismatch_penalty(mismatch: Mismatch, noise: float, config: ConfidenceConfig) -> float:
    """Return the term that structure which does not match, and a noisy frame, add to the weighted sum: 0 or less.

    Args:
        mismatch: What only the model or only the scene has.
        noise: Standard deviation of the frame's depth [m].
        config: Limits and coefficients.
    """
    patch = config.patch_weight * max(mismatch.patch - config.patch, 0.0)
    stray = config.stray_weight * max(mismatch.stray - config.stray, 0.0)
    return patch + stray + config.noise_weight * max(noise - config.noise, 0.0)


def error_penalty(rotation_error: float, config: ConfidenceConfig) -> float:
    """Return the term that the expected error of a pose's rotation adds to the weighted sum.

    Args:
        rotation_error: Standard deviation of the rotation in its worst direction [rad]; see
            `perception.pose.verification.expected_error`.
        config: Limits and coefficient.

    Raises:
        ValueError: ``rotation_error`` is NaN.
    """
    if np.isnan(rotation_error):
        raise ValueError(f"rotation_error must not be NaN, got {rotation_error}")
    return config.rotation_error * float(_beyond(np.float64(rotation_error), config))


def predictors(
    verdicts: Floats,
    margins: Floats,
    score_drops: Floats,
    sizes: Floats,
    rotation_errors: Floats,
    config: ConfidenceConfig,
) -> Floats:
    """Return the (E, 9) predictors of the regression, in the order of `COEFFICIENTS`.

    Args:
        verdicts: (E, 3) edge score, support and violation of each pose.
        margins: (E,) margin of each pose.
        score_drops: (E,) score drop of each pose.
        sizes: (E,) number of boundary points of each group after thinning, at least 1.
        rotation_errors: (E,) expected error of each pose's rotation [rad].
        config: Limits to which margins, score drops and expected errors are clipped.
    """
    clipped = [
        np.clip(values, -limit, limit) for values in (margins, score_drops) for limit in (config.clear, config.close)
    ]
    return np.column_stack([verdicts, *clipped, np.log(sizes), _beyond(rotation_errors, config)])


def _beyond(rotation_errors: Floats | np.float64, config: ConfidenceConfig) -> Floats:
    """Return by how much expected errors exceed ``exact``, up to ``unknown`` [rad]."""
    return np.asarray(np.clip(rotation_errors - config.exact, 0.0, config.unknown - config.exact), np.float64)


def confidences(predicted_by: Floats, config: ConfidenceConfig, penalty: float | Floats = 0.0) -> Floats:
    """Return the (E,) probability that each pose is right, from its (E, 9) :func:`predictors`.

    Args:
        predicted_by: (E, 9) predictors.
        config: Coefficients.
        penalty: Term that is added to the weighted sums, one or (E,).
    """
    weighted = config.bias + predicted_by @ np.array([getattr(config, name) for name in COEFFICIENTS]) + penalty
    probability: Floats = 0.5 * (1 + np.tanh(weighted / 2))
    return probability
