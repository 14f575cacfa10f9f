"""Recognition rate, recall, precision and reliability over S scenes, with 95 % intervals from R resamples."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from binpick_env.evaluation.pose.scene_score import PoseSceneScore
from perception.geometry import Floats
from perception.metrics.average_precision import percentile_interval
from perception.metrics.intervals import wilson_interval

RELIABILITY_BINS = 10  # equal bins of the score in [0, 1]
METHODS = {  # by number: how its interval is computed
    "recognition_rate": "Wilson, over trials",
    "recall": "percentile bootstrap over scenes",
    "precision": "Wilson, over poses",
    "by_visible_fraction": "Wilson, over parts",
    "reliability": "Wilson, over poses",
}


@dataclass(frozen=True, kw_only=True)
class PoseBand:
    """Recall of the parts in one band of visible fractions.

    Attributes:
        low: Lower limit of the visible fraction, inclusive.
        high: Upper limit of the visible fraction, exclusive below 1.
        parts: Number of parts in the band.
        found: Number of these parts with a correct verified pose.
        recall: Share of the parts that were found; NaN without a part.
        interval: 95 % interval of the recall.
    """

    low: float
    high: float
    parts: int
    found: int
    recall: float
    interval: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class ReliabilityBin:
    """Poses, verified or not, whose scores lie in one tenth of [0, 1].

    Attributes:
        low: Lower limit of the score, inclusive.
        high: Upper limit of the score, exclusive below 1.
        poses: Number of poses in the bin.
        right: Number of these poses that are correct for some part.
        share: Share of the poses that are correct; NaN without a pose.
        interval: 95 % interval of the share.
        mean_score: Mean score, which equals the share if scores are calibrated probabilities; NaN without a pose.
    """

    low: float
    high: float
    poses: int
    right: int
    share: float
    interval: tuple[float, float]
    mean_score: float


def pose_counts(scores: Sequence[PoseSceneScore], verified: bool = True) -> Floats:
    """Return the (S, 6) counts of each scene: recognised, trials, parts found, parts to find, correct poses, poses."""
    rows = []
    for score in scores:
        given = score.verified if verified else score.all_poses
        found = (given.found & score.to_find).sum()
        recognised = score.trials.recognised
        rows.append(
            [recognised.sum(), len(recognised), found, score.to_find.sum(), given.correct.sum(), len(given.correct)]
        )
    return np.array(rows, np.float64).reshape(-1, 6)


def bootstrap_weights(scenes: int, rng: np.random.Generator, resamples: int) -> Floats:
    """Draw how often each scene occurs in each resample, (R, S)."""
    return rng.multinomial(scenes, np.full(scenes, 1.0 / scenes), size=resamples).astype(np.float64)


def resampled_quotients(counts: Floats, weights: Floats) -> Floats:
    """Return (R, 3) recognition rate, recall and precision of scenes weighted by (R, S) ``weights``; NaN for 0 / 0."""
    sums = weights @ counts
    below = sums[:, 1::2]
    quotients: Floats = np.divide(sums[:, ::2], below, out=np.full(below.shape, np.nan), where=below > 0)
    return quotients


def pose_intervals(counts: Floats, weights: Floats) -> dict[str, tuple[float, float]]:
    """Return the 95 % intervals of recognition rate, recall and precision by the methods in `METHODS`.

    Recall is resampled over scenes, because the parts of a scene are not independent. Wrong poses are rare: from scenes
    without any wrong pose the bootstrap would conclude that precision is certainly 1.
    """
    sums = counts.sum(axis=0).astype(int).tolist()
    return {
        "recognition_rate": wilson_interval(sums[0], sums[1]),
        "recall": percentile_interval(resampled_quotients(counts, weights)[:, 1]),
        "precision": wilson_interval(sums[4], sums[5]),
    }


def reliability(scores: Sequence[PoseSceneScore]) -> list[ReliabilityBin]:
    """Return the share of correct poses for each tenth of the score."""
    values, correct = _all_poses(scores)
    tenths = np.minimum((values * RELIABILITY_BINS).astype(int), RELIABILITY_BINS - 1)
    bins = []
    for k in range(RELIABILITY_BINS):
        inside = tenths == k
        hits, count = int(correct[inside].sum()), int(inside.sum())
        bins.append(
            ReliabilityBin(
                low=k / RELIABILITY_BINS,
                high=(k + 1) / RELIABILITY_BINS,
                poses=count,
                right=hits,
                share=quotient(hits, count),
                interval=wilson_interval(hits, count),
                mean_score=float(values[inside].mean()) if count else np.nan,
            )
        )
    return bins


def visible_band(scores: Sequence[PoseSceneScore], low: float, high: float) -> PoseBand:
    """Return the recall of the parts of one band of visible fractions."""
    inside = [(score.visible_fractions >= low) & (score.visible_fractions < high) for score in scores]
    parts = int(sum(mask.sum() for mask in inside))
    found = int(sum(score.verified.found[mask].sum() for score, mask in zip(scores, inside, strict=True)))
    interval = wilson_interval(found, parts)
    share = quotient(found, parts)
    return PoseBand(low=low, high=min(high, 1.0), parts=parts, found=found, recall=share, interval=interval)


def calibration_error(bins: Sequence[ReliabilityBin]) -> float:
    """Return the expected calibration error: the bins' mean |share - mean score|, weighted by their poses."""
    filled = [each for each in bins if each.poses]
    total = sum(each.poses * abs(each.share - each.mean_score) for each in filled)
    return quotient(total, sum(each.poses for each in filled))


def brier(scores: Sequence[PoseSceneScore]) -> float:
    """Return the Brier score: mean squared difference between a score and 1 for correct, 0 for wrong."""
    values, correct = _all_poses(scores)
    return float(np.mean((values - correct) ** 2)) if len(values) else np.nan


def ms_per_group(scores: Sequence[PoseSceneScore]) -> float:
    """Return the median over scenes of the pose estimation's time per group [ms]; NaN without groups."""
    return median([score.ms["pose"] / score.groups for score in scores if score.groups])


def median(values: Sequence[float]) -> float:
    """Return the median of the values that are not NaN; NaN if there is none."""
    known = [value for value in values if not np.isnan(value)]
    return float(np.median(known)) if known else np.nan


def quotient(count: float, total: float) -> float:
    """Return ``count / total``; NaN if the total is 0."""
    return float(count / total) if total else np.nan


def _all_poses(scores: Sequence[PoseSceneScore]) -> tuple[Floats, Floats]:
    """Return the score of every pose of every scene, and 1 for correct or 0 for wrong."""
    values = np.concatenate([score.scores for score in scores])
    return values, np.concatenate([score.correct for score in scores]).astype(np.float64)
