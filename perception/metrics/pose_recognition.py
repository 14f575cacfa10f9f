"""Verdicts on the estimated poses of a bin, precision and recall over bins, and Bregier's average precision.

Source: Bregier et al., "Symmetry aware evaluation of 3D object detection and pose estimation in scenes of many parts in
bulk", ICCVW 2017.

Shapes: E estimates, P true instances, K operating points, S scenes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, require_shape
from perception.metrics.average_precision import PrecisionRecall

MAX_DISTANCE = 0.10  # distance up to which an estimate belongs to an instance, as a share of the diameter
MIN_VISIBLE = 0.5  # visible fraction from which on an instance has to be found


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseVerdicts:
    """The verdicts on the estimates of one scene.

    Attributes:
        scores: (E,) confidence of each estimate.
        claims: (E,) int64 true instance that each estimate belongs to, -1 for none.
        correct: (E,) bool, whether an estimate is the best-scored one of an instance that has to be found.
        excused: (E,) bool, whether an estimate is the best-scored one of an instance that need not be found. It is
            neither right nor wrong.
        to_find: Number of instances that have to be found.
    """

    scores: Floats
    claims: NDArray[np.int64]
    correct: NDArray[np.bool_]
    excused: NDArray[np.bool_]
    to_find: int

    def __post_init__(self) -> None:
        require_shape("scores", self.scores, (None,))
        for name in ("claims", "correct", "excused"):
            require_shape(name, getattr(self, name), (len(self.scores),))
        if not np.isfinite(self.scores).all():
            raise ValueError(f"scores must be finite, got {self.scores.tolist()}")
        if (self.correct & self.excused).any():
            raise ValueError("an estimate cannot be both correct and excused")
        if self.to_find < self.correct.sum():
            raise ValueError(f"to_find must be at least the {self.correct.sum()} found, got {self.to_find}")


def judge_poses(distances: Floats, scores: Floats, to_find: NDArray[np.bool_], max_distance: float) -> PoseVerdicts:
    """Judge the estimates of a scene.

    Each estimate belongs to its nearest instance, or to none if that is ``max_distance`` away or more. The best-scored
    estimate of an instance (the first of equal scores) is right, or excused if the instance need not be found. All
    other estimates are wrong: duplicates, and those that belong to no instance.

    Differs from Bregier's script in two ways. The script takes the nearest duplicate for the right one, which gives the
    same counts at every score. Between parts that lie closer than twice ``max_distance``, the script may assign an
    instance to a nearer estimate of another instance.

    Args:
        distances: (E, P) distance from each estimate to each true instance [m]; an infinite one is never a match. Use
            `PoseSpace.distances` with a ``max_distance`` of `MAX_DISTANCE` times the diameter, or
            `recognition_distances` with an infinite ``max_distance``.
        scores: (E,) confidence of each estimate.
        to_find: (P,) bool, whether an instance has to be found; see `visible_enough`.
        max_distance: Distance from which on an estimate belongs to no instance [m].

    Raises:
        ValueError: The shapes do not agree, a distance is negative or NaN, ``max_distance`` is not positive, or a
            score is not finite.
    """
    require_shape("scores", scores, (None,))
    require_shape("to_find", to_find, (None,))
    require_shape("distances", distances, (len(scores), len(to_find)))
    if not (distances >= 0).all():
        raise ValueError("distances must be 0 or more, and not NaN")
    if not max_distance > 0:
        raise ValueError(f"max_distance must be positive, got {max_distance}")
    claims = np.full(len(scores), -1, np.int64)
    correct, excused = np.zeros((2, len(scores)), np.bool_)
    taken: set[int] = set()
    for e in np.argsort(-scores, kind="stable").tolist() if len(to_find) else []:
        nearest = int(np.argmin(distances[e]))
        if distances[e, nearest] < max_distance:
            claims[e] = nearest
            if nearest not in taken:
                taken.add(nearest)
                correct[e], excused[e] = to_find[nearest], not to_find[nearest]
    found = int(to_find.sum())
    return PoseVerdicts(scores=scores, claims=claims, correct=correct, excused=excused, to_find=found)


def visible_enough(visible_fractions: Floats, min_visible: float = MIN_VISIBLE) -> NDArray[np.bool_]:
    """Return the (P,) mask of instances whose visible fraction is at least ``min_visible``: they have to be found."""
    enough: NDArray[np.bool_] = visible_fractions >= min_visible
    return enough


def pose_precision_recall(scenes: Sequence[PoseVerdicts], *, pooled: bool = False) -> PrecisionRecall:
    """Return precision and recall at every score that occurs, by ascending score.

    Bregier's curve is the mean over scenes of the precision (1 for a scene that accepts nothing) and the recall at the
    same score. Scenes with nothing to find have no recall and are left out of its mean; Bregier's script gives them
    recall 1.

    Args:
        scenes: Verdicts on each scene.
        pooled: Count the estimates and instances of all scenes together instead.

    Raises:
        ValueError: There is no scene.
    """
    if len(scenes) == 0:
        raise ValueError("at least 1 scene is needed, got none")
    thresholds = np.append(np.unique(np.concatenate([scene.scores for scene in scenes])), np.inf)
    right = np.stack([_accepted(scene.scores[scene.correct], thresholds) for scene in scenes])
    every = np.stack([_accepted(scene.scores[~scene.excused], thresholds) for scene in scenes])
    truths = np.array([scene.to_find for scene in scenes], np.float64)
    if pooled:
        right, every, truths = (count.sum(axis=0, keepdims=True) for count in (right, every, truths))
    precision = np.divide(right, every, out=np.ones_like(right), where=every > 0).mean(axis=0)
    known = truths > 0
    recall = (right[known] / truths[known, None]).mean(axis=0) if known.any() else np.full(len(thresholds), np.nan)
    return PrecisionRecall(precision=precision, recall=recall, scores=thresholds)


def pose_average_precision(curve: PrecisionRecall) -> float:
    """Return Bregier's area under a curve of `pose_precision_recall`; NaN without an instance to find.

    It is the sum of each precision times the step in recall that reaches it, without interpolation. ScanNet's average
    precision of segments uses another rule.
    """
    steps = np.diff(curve.recall[::-1], prepend=0.0)
    return float(steps @ curve.precision[::-1])


def _accepted(scores: Floats, thresholds: Floats) -> Floats:
    """Return the (K,) number of ``scores`` that are at least each threshold."""
    return (len(scores) - np.searchsorted(np.sort(scores), thresholds, side="left")).astype(np.float64)
