"""ScanNet's average precision from matched scenes, with intervals over scenes.

R resamples of the scenes, E verdicts, C classes, O overlaps.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, require_shape
from perception.metrics.matching import MATCHED_OVERLAPS, OVERLAPS, SceneMatches

CHUNK = 1_000_000  # verdicts times resamples that are counted at once: about 50 MB


@dataclass(frozen=True, kw_only=True)
class ClassAp:
    """Average precisions of one class; NaN where no scene has an instance of it to find.

    Attributes:
        ap: Mean of the average precisions at IoU 0.50, 0.55 ... 0.90.
        ap50: Average precision at IoU 0.50.
        ap75: Average precision at IoU 0.75.
        ap25: Average precision at IoU 0.25.
    """

    ap: float
    ap50: float
    ap75: float
    ap25: float


@dataclass(frozen=True, kw_only=True)
class ApSummary(ClassAp):
    """Average precisions as means over the classes that have an instance to find.

    Attributes:
        per_class: Average precisions by class, for every class that occurs in a truth or a prediction.
    """

    per_class: dict[int, ClassAp]


@dataclass(frozen=True, kw_only=True)
class ApIntervals:
    """95 % intervals (low, high) of the average precisions; NaN where no resample has an instance to find."""

    ap: tuple[float, float]
    ap50: tuple[float, float]
    ap75: tuple[float, float]
    ap25: tuple[float, float]


class PrecisionRecall(NamedTuple):
    """Operating points by ascending score. The last one, at an infinite score, has precision 1 and recall 0.

    Attributes:
        precision: (K,) precision in [0, 1].
        recall: (K,) recall in [0, 1]; NaN without an instance to find.
        scores: (K,) lowest score that is accepted.
    """

    precision: Floats
    recall: Floats
    scores: Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class _Pool:
    """The verdicts of all scenes on one class at one overlap, by descending score.

    Attributes:
        scores: (E,) confidence, descending.
        correct: (E,) 1 for a right prediction, 0 for a wrong one.
        scene_idx: (E,) int64 scene of each verdict.
        truths: (S,) number of instances to find in each scene.
        ends: (K,) index of the last verdict of each score, as equal scores are one operating point.
    """

    scores: Floats
    correct: Floats
    scene_idx: NDArray[np.int64]
    truths: Floats
    ends: NDArray[np.int64]

    def counts(self, weights: Floats) -> tuple[Floats, Floats, Floats]:
        """Return (R, 1 + K) true positives, (R, 1 + K) positives and (R,) truths for (R, S) weights of the scenes."""
        weight = weights[:, self.scene_idx]
        right = np.cumsum(weight * self.correct, axis=1)[:, self.ends]
        every = np.cumsum(weight, axis=1)[:, self.ends]
        start = np.zeros((len(weights), 1))
        return np.hstack([start, right]), np.hstack([start, every]), weights @ self.truths


def average_precision(matches: Sequence[SceneMatches], overlaps: Sequence[float] = OVERLAPS) -> dict[int, Floats]:
    """Return the (O,) average precisions at ``overlaps`` by class, all scenes pooled.

    As in ScanNet's benchmark, it is NaN where no scene has an instance to find, and 0 where nothing is predicted. It is
    0 also where every prediction is ignored, a case in which the benchmark's script crashes.

    Raises:
        ValueError: A scene was not matched at one of ``overlaps``.
    """
    values = _resampled(matches, overlaps, np.ones((1, len(matches))))
    return {label: values[0, c] for c, label in enumerate(_classes(matches))}


def ap_summary(matches: Sequence[SceneMatches]) -> ApSummary:
    """Return AP, AP50, AP75 and AP25 of scenes matched at `MATCHED_OVERLAPS`, as means and by class.

    Raises:
        ValueError: A scene was not matched at all ten overlaps.
    """
    values = _four(_resampled(matches, MATCHED_OVERLAPS, np.ones((1, len(matches)))))
    per_class = {}
    for label, (ap, ap50, ap75, ap25) in zip(_classes(matches), values[0].tolist(), strict=True):
        per_class[label] = ClassAp(ap=ap, ap50=ap50, ap75=ap75, ap25=ap25)
    ap, ap50, ap75, ap25 = _mean_of_known(values, axis=1)[0].tolist()
    return ApSummary(ap=ap, ap50=ap50, ap75=ap75, ap25=ap25, per_class=per_class)


def bootstrap_ap(matches: Sequence[SceneMatches], rng: np.random.Generator, resamples: int = 1000) -> ApIntervals:
    """Return percentile intervals of the average precisions, by a bootstrap over scenes.

    Scenes are drawn rather than parts, because the parts of one bin fail together. Resamples without an instance to
    find are left out.

    Args:
        matches: Verdicts on each scene.
        rng: Source of the draws.
        resamples: Number of resamples.

    Raises:
        ValueError: There is no scene, ``resamples`` is below 1, or a scene was not matched at all ten overlaps.

    Note:
        It takes about 2 s for 1000 resamples of 100 scenes with 40 predictions each.
    """
    scenes = len(matches)
    if scenes < 1 or resamples < 1:
        raise ValueError(f"at least 1 scene and 1 resample are needed, got {scenes} and {resamples}")
    weights = rng.multinomial(scenes, np.full(scenes, 1.0 / scenes), size=resamples).astype(np.float64)
    four = weighted_ap(matches, weights)
    ap, ap50, ap75, ap25 = (percentile_interval(four[:, k]) for k in range(4))
    return ApIntervals(ap=ap, ap50=ap50, ap75=ap75, ap25=ap25)


def weighted_ap(matches: Sequence[SceneMatches], weights: Floats) -> Floats:
    """Return the (R, 4) AP, AP50, AP75, AP25 over the classes, for weighted scenes; NaN without an instance to find.

    Args:
        matches: Verdicts on each of S scenes.
        weights: (R, S) number of times that each scene counts.

    Raises:
        ValueError: A scene was not matched at all ten overlaps, or the weights are not one a scene.
    """
    require_shape("weights", weights, (None, len(matches)))
    return _mean_of_known(_four(_resampled(matches, MATCHED_OVERLAPS, weights)), axis=1)


def precision_recall(matches: Sequence[SceneMatches], overlap: float, label: int = 0) -> PrecisionRecall:
    """Return precision and recall of class ``label`` at IoU ``overlap``, all scenes pooled.

    Raises:
        ValueError: A scene was not matched at ``overlap``.
    """
    pool = _pooled(matches, overlap, label)
    right, every, truths = pool.counts(np.ones((1, len(matches))))
    recall = right[0] / truths[0] if truths[0] else np.full(len(right[0]), np.nan)
    scores = np.concatenate([[np.inf], pool.scores[pool.ends]])
    return PrecisionRecall(precision=_precision(right, every)[0, ::-1], recall=recall[::-1], scores=scores[::-1])


def _classes(matches: Sequence[SceneMatches]) -> list[int]:
    """Return the classes that occur in a truth or a verdict, ascending."""
    return sorted({label for scene in matches for label in (*scene.truth_counts, *scene.labels.tolist())})


def _pooled(matches: Sequence[SceneMatches], overlap: float, label: int) -> _Pool:
    """Gather the verdicts of all scenes."""
    scores, correct, scene_idx = [np.empty(0)], [np.empty(0)], [np.empty(0, np.int64)]
    for s, scene in enumerate(matches):
        if overlap not in scene.overlaps:
            raise ValueError(f"scene {s} was not matched at overlap {overlap}, but at {scene.overlaps}")
        mine = (scene.labels == label) & (scene.overlap_idx == scene.overlaps.index(overlap))
        scores.append(scene.scores[mine])
        correct.append(scene.correct[mine].astype(np.float64))
        scene_idx.append(np.full(int(mine.sum()), s))
    pooled = np.concatenate(scores)
    order = np.argsort(-pooled, kind="stable")
    ranked = pooled[order]
    return _Pool(
        scores=ranked,
        correct=np.concatenate(correct)[order],
        scene_idx=np.concatenate(scene_idx)[order],
        truths=np.array([scene.truth_counts.get(label, 0) for scene in matches], np.float64),
        ends=np.flatnonzero(np.diff(ranked, append=-np.inf)),
    )


def _resampled(matches: Sequence[SceneMatches], overlaps: Sequence[float], weights: Floats) -> Floats:
    """Return the (R, C, O) average precision for (R, S) weights of the scenes."""
    classes = _classes(matches)
    values = np.empty((len(weights), len(classes), len(overlaps)))
    for c, label in enumerate(classes):
        for o, overlap in enumerate(overlaps):
            pool = _pooled(matches, overlap, label)
            step = max(1, CHUNK // max(len(pool.scores), 1))
            for first in range(0, len(weights), step):
                values[first : first + step, c, o] = _area(*pool.counts(weights[first : first + step]))
    return values


def _area(right: Floats, every: Floats, truths: Floats) -> Floats:
    """Return the (R,) area under precision over recall, NaN without truths.

    ScanNet sums the precision P_k times the centred step (R_{k-1} - R_{k+1}) / 2, with R extended at both ends. Summed
    over intervals instead of points, this is the trapezoidal rule without interpolation to an envelope. A score that no
    drawn scene has repeats the point of its neighbour and adds nothing.
    """
    precision = _precision(right, every)
    steps = (precision[:, 1:] + precision[:, :-1]) / 2 * np.diff(right, axis=1)
    area: Floats = np.divide(steps.sum(axis=1), truths, out=np.full(len(truths), np.nan), where=truths > 0)
    return area


def _precision(right: Floats, every: Floats) -> Floats:
    return np.divide(right, every, out=np.ones_like(right), where=every > 0)


def _four(values: Floats) -> Floats:
    """Return (R, C, 4) AP, AP50, AP75, AP25 of (R, C, 10) average precisions at `MATCHED_OVERLAPS`."""
    at = [MATCHED_OVERLAPS.index(overlap) for overlap in (0.5, 0.75, 0.25)]
    return np.concatenate([values[..., 1:].mean(axis=-1, keepdims=True), values[..., at]], axis=-1)


def _mean_of_known(values: Floats, axis: int) -> Floats:
    """Return the mean of the values along ``axis`` that are not NaN, or NaN if there are none."""
    known = ~np.isnan(values)
    number = known.sum(axis=axis)
    total = np.where(known, values, 0.0).sum(axis=axis)
    mean: Floats = np.divide(total, number, out=np.full(total.shape, np.nan), where=number > 0)
    return mean


def percentile_interval(values: Floats) -> tuple[float, float]:
    """Return the 95 % interval (low, high) of the (R,) values that are not NaN; NaN twice if there are none."""
    known = values[~np.isnan(values)]
    if not len(known):
        return np.nan, np.nan
    low, high = np.quantile(known, (0.025, 0.975))
    return float(low), float(high)
