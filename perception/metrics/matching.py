"""Matching of predicted with true instances by the rules of ScanNet's instance benchmark.

A scene is matched once. The average precision of any pool or resample of scenes then counts the verdicts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, require_shape
from perception.instance import Instance

OVERLAPS = (0.50, 0.55, 0.60, 0.65, 0.70, 0.75, 0.80, 0.85, 0.90)  # "AP" is the mean over these nine
MATCHED_OVERLAPS = (0.25, *OVERLAPS)
MIN_REGION = 100  # smallest number of points of a true or predicted instance


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneTruth:
    """The true instances of a scene.

    Attributes:
        instance_ids: (N,) int64 instance of each point, -1 for void (unlabelled, or of a class that is not scored).
        class_of_instance: (P,) int64 semantic class of each instance.
        ignored: (P,) bool, whether an instance need not be found. Predictions on ignored instances are neither right
            nor wrong. To score a band of visible fractions, ignore the parts outside it.
    """

    instance_ids: NDArray[np.int64]
    class_of_instance: NDArray[np.int64]
    ignored: NDArray[np.bool_]

    def __post_init__(self) -> None:
        require_shape("instance_ids", self.instance_ids, (None,))
        require_shape("class_of_instance", self.class_of_instance, (None,))
        parts = len(self.class_of_instance)
        require_shape("ignored", self.ignored, (parts,))
        if self.ignored.dtype != np.bool_:
            raise ValueError(f"ignored must be bool, got {self.ignored.dtype}")
        low, high = self.instance_ids.min(initial=-1), self.instance_ids.max(initial=-1)
        if low < -1 or high >= parts:
            raise ValueError(f"instance_ids must be -1 to {parts - 1} for {parts} instances, got {low} to {high}")

    def counted(self, min_region: int) -> NDArray[np.bool_]:
        """Return the (P,) mask of instances that have to be found: not ignored, with ``min_region`` points or more."""
        return ~self.ignored & (self.sizes() >= min_region)

    def sizes(self) -> NDArray[np.int64]:
        """Return the (P,) number of points of each instance."""
        return np.bincount(self.instance_ids + 1, minlength=len(self.ignored) + 1)[1:]


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneMatches:
    """The E verdicts on the predictions of a scene, each for one prediction at one overlap.

    Attributes:
        overlaps: IoU thresholds that the scene was matched at.
        truth_counts: Number of instances that have to be found, by class.
        labels: (E,) int64 semantic class of each verdict.
        overlap_idx: (E,) int64 index into ``overlaps``.
        scores: (E,) confidence of the prediction.
        correct: (E,) bool, whether the prediction is right. A prediction that is ignored at an overlap has no verdict.
    """

    overlaps: tuple[float, ...]
    truth_counts: dict[int, int]
    labels: NDArray[np.int64]
    overlap_idx: NDArray[np.int64]
    scores: Floats
    correct: NDArray[np.bool_]

    def __post_init__(self) -> None:
        require_shape("labels", self.labels, (None,))
        for name in ("overlap_idx", "scores", "correct"):
            require_shape(name, getattr(self, name), (len(self.labels),))


def match_scene(
    truth: SceneTruth,
    instances: Sequence[Instance],
    overlaps: Sequence[float] = MATCHED_OVERLAPS,
    min_region: int = MIN_REGION,
) -> SceneMatches:
    """Match predicted with true instances at each IoU threshold.

    The rules are those of the ScanNet benchmark's instance evaluation (Dai et al., CVPR 2017). Within a class, each
    true instance, in ascending id, takes the first free prediction, in the order given, whose IoU is strictly greater
    than the overlap. Further such predictions are duplicates: the one of greatest confidence is right, the others are
    wrong. A prediction without such a true instance is wrong, unless more than the overlap's share of its points lies
    on void or on instances of its class that do not count. Predictions under ``min_region`` points are dropped.

    Args:
        truth: True instances of the scene.
        instances: Predicted instances, which may share points.
        overlaps: IoU thresholds.
        min_region: Number of points from which on an instance counts.

    Raises:
        ValueError: Points of an instance are outside the scene or not ascending, an overlap is outside [0, 1), or
            ``min_region`` is below 1.
    """
    if min_region < 1:
        raise ValueError(f"min_region must be at least 1 point, got {min_region}")
    if not all(0 <= overlap < 1 for overlap in overlaps):
        raise ValueError(f"overlaps must be at least 0 and less than 1, got {tuple(overlaps)}")
    _require_points(instances, len(truth.instance_ids))
    kept = [instance for instance in instances if len(instance.point_idx) >= min_region]
    scores = np.array([instance.score for instance in kept], np.float64)
    labels = np.array([instance.label for instance in kept], np.int64)
    void, shared, ious = _shared_points(truth, kept)
    counted = truth.counted(min_region)
    sizes = np.array([len(instance.point_idx) for instance in kept], np.int64)
    excused_share = (void + shared[:, ~counted].sum(axis=1)) / sizes

    verdicts: list[tuple[int, int, float, bool]] = []
    for o, overlap in enumerate(overlaps):
        fits = ious > overlap
        wrong = ~fits.any(axis=1) & (excused_share <= overlap)
        verdicts += [(int(labels[k]), o, float(scores[k]), False) for k in np.flatnonzero(wrong)]
        for t, score, correct in _take_turns(fits & counted, scores):
            verdicts.append((int(truth.class_of_instance[t]), o, score, correct))
    classes, numbers = np.unique(truth.class_of_instance[counted], return_counts=True)
    return SceneMatches(
        overlaps=tuple(overlaps),
        truth_counts=dict(zip(classes.tolist(), numbers.tolist(), strict=True)),
        labels=np.array([v[0] for v in verdicts], np.int64),
        overlap_idx=np.array([v[1] for v in verdicts], np.int64),
        scores=np.array([v[2] for v in verdicts], np.float64),
        correct=np.array([v[3] for v in verdicts], np.bool_),
    )


def object_ious(truth: SceneTruth, instances: Sequence[Instance]) -> Floats:
    """Return the (P,) best IoU of each true instance with a prediction of its class; NaN where it has no points.

    Raises:
        ValueError: Points of an instance are outside the scene or not ascending.

    Note:
        Predictions of every size count, and one prediction may be the best one of several true instances.
    """
    return np.where(truth.sizes() > 0, instance_ious(truth, instances).max(axis=0, initial=0.0), np.nan)


def instance_ious(truth: SceneTruth, instances: Sequence[Instance]) -> Floats:
    """Return the (Q, P) IoU of each prediction with each true instance; 0 for another class.

    Raises:
        ValueError: Points of an instance are outside the scene or not ascending.
    """
    _require_points(instances, len(truth.instance_ids))
    return _shared_points(truth, instances)[2]


def _take_turns(fits: NDArray[np.bool_], scores: Floats) -> Iterator[tuple[int, float, bool]]:
    """Yield (true instance, score, right or wrong) for the predictions that fit a true instance, (Q, P) ``fits``.

    Note:
        A duplicate stays free for the true instances that follow, as in the benchmark's script.
    """
    used = np.zeros(len(scores), np.bool_)
    for t in np.flatnonzero(fits.any(axis=0)):
        free = np.flatnonzero(fits[:, t] & ~used)
        if len(free):
            used[free[0]] = True
            ranked = np.sort(scores[free])
            yield int(t), float(ranked[-1]), True
            yield from ((int(t), float(score), False) for score in ranked[:-1])


def _shared_points(
    truth: SceneTruth, instances: Sequence[Instance]
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Return for Q predictions the points on void (Q,), those shared with true instances (Q, P), and the IoU (Q, P)."""
    ids, columns = truth.instance_ids + 1, len(truth.ignored) + 1
    hits = np.zeros((len(instances), columns), np.int64)
    for k, instance in enumerate(instances):
        hits[k] = np.bincount(ids[instance.point_idx], minlength=columns)
    labels = np.array([instance.label for instance in instances], np.int64)
    shared = hits[:, 1:] * (labels[:, None] == truth.class_of_instance)
    union = hits.sum(axis=1)[:, None] + truth.sizes() - shared
    return hits[:, 0], shared, np.divide(shared, union, out=np.zeros(shared.shape), where=shared > 0)


def _require_points(instances: Sequence[Instance], count: int) -> None:
    for k, instance in enumerate(instances):
        idx = instance.point_idx
        if len(idx) and not (idx[0] >= 0 and idx[-1] < count and (np.diff(idx) > 0).all()):
            raise ValueError(f"point_idx of instance {k} must ascend within 0 to {count - 1}, without repeats")
