"""Shares of trials, parts and poses over judged scenes, with their 95 % intervals. S scenes, R resamples."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from binpick_env.evaluation.pose.judgement import PoseScore
from perception.geometry import Floats
from perception.metrics.average_precision import percentile_interval
from perception.metrics.intervals import wilson_interval

RELIABILITY_BINS = 10
METHODS = {
    "recognition_rate": "Wilson, over trials",
    "recall": "percentile bootstrap over scenes",
    "precision": "Wilson, over poses",
    "by_visible_fraction": "Wilson, over parts",
    "reliability": "Wilson, over poses",
}


@dataclass(frozen=True, kw_only=True)
class PoseBand:
    """The parts of one band of visible fractions.

    Attributes:
        low: Smallest visible fraction.
        high: First beyond the band.
        parts: In the band.
        found: Of these, with a right verified pose.
        recall: Their share; NaN without a part.
        interval: 95 % of it.
    """

    low: float
    high: float
    parts: int
    found: int
    recall: float
    interval: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class ReliabilityBin:
    """The poses, verified or not, whose scores lie in one tenth of [0, 1].

    Attributes:
        low: Smallest score.
        high: First beyond.
        poses: In the bin.
        right: Of these, right for some part.
        share: The quotient; NaN without a pose.
        interval: 95 % of it.
        mean_score: What ``share`` would be if scores were probabilities; NaN without a pose.
    """

    low: float
    high: float
    poses: int
    right: int
    share: float
    interval: tuple[float, float]
    mean_score: float


def pose_counts(scores: Sequence[PoseScore], verified: bool = True) -> Floats:
    """Return (S, 6) of each scene: recognised, trials, parts found, parts to find, right poses, poses delivered."""
    rows = []
    for score in scores:
        given = score.delivered if verified else score.every
        found = (given.found & score.to_find).sum()
        recognised = score.trials.recognised
        rows.append(
            [recognised.sum(), len(recognised), found, score.to_find.sum(), given.right.sum(), len(given.right)]
        )
    return np.array(rows, np.float64).reshape(-1, 6)


def bootstrap_weights(scenes: int, rng: np.random.Generator, resamples: int) -> Floats:
    """Return (R, S) how often each scene is drawn in each resample."""
    return rng.multinomial(scenes, np.full(scenes, 1.0 / scenes), size=resamples).astype(np.float64)


def resampled_quotients(counts: Floats, weights: Floats) -> Floats:
    """Return (R, 3) recognition rate, recall and precision, scenes counting (R, S) ``weights`` times; NaN for 0 / 0."""
    sums = weights @ counts
    below = sums[:, 1::2]
    quotients: Floats = np.divide(sums[:, ::2], below, out=np.full(below.shape, np.nan), where=below > 0)
    return quotients


def pose_intervals(counts: Floats, weights: Floats) -> dict[str, tuple[float, float]]:
    """Return the 95 % intervals of recognition rate, recall and precision, made as `METHODS` says.

    Recall is resampled over scenes, whose parts are hidden together. Wrong poses are few and far between: from scenes
    without any the bootstrap would conclude that there are none.
    """
    sums = counts.sum(axis=0).astype(int).tolist()
    return {
        "recognition_rate": wilson_interval(sums[0], sums[1]),
        "recall": percentile_interval(resampled_quotients(counts, weights)[:, 1]),
        "precision": wilson_interval(sums[4], sums[5]),
    }


def reliability(scores: Sequence[PoseScore]) -> list[ReliabilityBin]:
    """Return what a score in each tenth of [0, 1] is worth."""
    values, right = _all_poses(scores)
    tenths = np.minimum((values * RELIABILITY_BINS).astype(int), RELIABILITY_BINS - 1)
    bins = []
    for k in range(RELIABILITY_BINS):
        mine = tenths == k
        hits, count = int(right[mine].sum()), int(mine.sum())
        bins.append(
            ReliabilityBin(
                low=k / RELIABILITY_BINS,
                high=(k + 1) / RELIABILITY_BINS,
                poses=count,
                right=hits,
                share=quotient(hits, count),
                interval=wilson_interval(hits, count),
                mean_score=float(values[mine].mean()) if count else np.nan,
            )
        )
    return bins


def visible_band(scores: Sequence[PoseScore], low: float, high: float) -> PoseBand:
    """Return the recall of the parts of one band of visible fractions."""
    inside = [(score.visible_fractions >= low) & (score.visible_fractions < high) for score in scores]
    parts = int(sum(mask.sum() for mask in inside))
    found = int(sum(score.delivered.found[mask].sum() for score, mask in zip(scores, inside, strict=True)))
    interval = wilson_interval(found, parts)
    share = quotient(found, parts)
    return PoseBand(low=low, high=min(high, 1.0), parts=parts, found=found, recall=share, interval=interval)


def calibration_error(bins: Sequence[ReliabilityBin]) -> float:
    """Return the mean difference between score and share, by the bins' number of poses."""
    filled = [each for each in bins if each.poses]
    off = sum(each.poses * abs(each.share - each.mean_score) for each in filled)
    return quotient(off, sum(each.poses for each in filled))


def brier(scores: Sequence[PoseScore]) -> float:
    """Return the mean square of the difference between a score and 1 or 0, right or wrong."""
    values, right = _all_poses(scores)
    return float(np.mean((values - right) ** 2)) if len(values) else np.nan


def ms_per_group(scores: Sequence[PoseScore]) -> float:
    """Return the median over scenes of the time that the poses of a group took [ms]; NaN without groups."""
    return median([score.ms["pose"] / score.groups for score in scores if score.groups])


def median(values: Sequence[float]) -> float:
    """Return the median of what is not NaN, NaN of nothing."""
    known = [value for value in values if not np.isnan(value)]
    return float(np.median(known)) if known else np.nan


def quotient(count: float, total: float) -> float:
    """Return a share, NaN of nothing."""
    return float(count / total) if total else np.nan


def _all_poses(scores: Sequence[PoseScore]) -> tuple[Floats, Floats]:
    """Return the score of every pose of every scene, and 1 or 0 for right or wrong."""
    values = np.concatenate([score.scores for score in scores])
    return values, np.concatenate([score.fits for score in scores]).astype(np.float64)
