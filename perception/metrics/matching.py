"""Which predicted instances are right, by the rules of ScanNet's instance benchmark: the first half of an AP.

A scene is matched once; average precision over any pool or resample of scenes only counts the decisions again.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, require_shape
from perception.instance import Instance

OVERLAPS = (0.50, 0.55, 0.60, 0.65, 0.70, 0.75, 0.80, 0.85, 0.90)  # "AP" is the mean over these nine
MATCHED_OVERLAPS = (0.25, *OVERLAPS)
MIN_REGION = 100  # points, of ground truths and of predictions


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneTruth:
    """The true instances of a scene.

    Attributes:
        instance_ids: (N,) int64 instance of each point, -1 for void: unlabelled, or of a class that is not scored.
        class_of_instance: (P,) int64 semantic class of each instance.
        ignored: (P,) bool instances that need not be found, as if they were too small: predictions on them are neither
            right nor wrong. To score a band of visible fractions alone, ignore the parts outside it.
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
        """Return (P,) which instances have to be found: not ignored, and of ``min_region`` points or more."""
        return ~self.ignored & (self.sizes() >= min_region)

    def sizes(self) -> NDArray[np.int64]:
        """Return (P,) number of points of each instance."""
        return np.bincount(self.instance_ids + 1, minlength=len(self.ignored) + 1)[1:]


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneMatches:
    """The verdicts on a scene's predictions, each for one overlap; E of them in all.

    Attributes:
        overlaps: The IoU thresholds that the scene was matched at.
        truth_counts: Number of instances that have to be found, by class. Those without a right verdict are missed.
        labels: (E,) int64 class.
        overlap_idx: (E,) int64 index into ``overlaps``.
        scores: (E,) confidence.
        correct: (E,) bool right or wrong; a prediction that is ignored at an overlap has no verdict there.
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
    """Judge ``instances``, whose points may overlap, at every IoU of ``overlaps``.

    The rules of the ScanNet benchmark's instance evaluation (Dai et al., CVPR 2017). Within a class, true instances in
    ascending id take the first free prediction, in the order given, whose IoU is strictly greater than the overlap.
    Further ones are duplicates: the greatest confidence is right, each other one wrong. A prediction that exceeds the
    overlap with no true instance is wrong, unless more than that share of it lies on void or on instances of its class
    that are ignored or under ``min_region`` points. Predictions under ``min_region`` points do not exist.

    Raises:
        ValueError: An instance names points that the scene has not, or not in ascending order; an overlap outside
            [0, 1); a ``min_region`` below 1.
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
    """Return (P,) the best IoU of each true instance with ``instances`` of its class; NaN where it has no points.

    Raises:
        ValueError: An instance names points that the scene has not, or not in ascending order.

    Note: predictions of every size count, and one may be the best of several true instances.
    """
    return np.where(truth.sizes() > 0, instance_ious(truth, instances).max(axis=0, initial=0.0), np.nan)


def instance_ious(truth: SceneTruth, instances: Sequence[Instance]) -> Floats:
    """Return the (Q, P) IoU of each instance with each true one of its class; 0 with one of another class.

    Raises:
        ValueError: An instance names points that the scene has not, or not in ascending order.
    """
    _require_points(instances, len(truth.instance_ids))
    return _shared_points(truth, instances)[2]


def _take_turns(fits: NDArray[np.bool_], scores: Floats) -> Iterator[tuple[int, float, bool]]:
    """Yield (true instance, score, right or wrong) for (Q, P) ``fits`` of Q predictions and P true instances.

    Note: a duplicate stays free for the true instances that follow, as in the benchmark's script.
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
    """Return (Q,) points on void, (Q, P) points shared with true instances of the same class, and their (Q, P) IoU."""
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
