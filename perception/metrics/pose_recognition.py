"""Which estimated poses of a bin are right, precision and recall over bins, and Bregier's average precision.

Source: Bregier et al., "Symmetry aware evaluation of 3D object detection and pose estimation in scenes of many parts in
bulk", ICCVW 2017. E estimates, P true instances, K operating points, S scenes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, require_shape
from perception.metrics.average_precision import PrecisionRecall

MAX_DISTANCE = 0.10  # of the diameter: an estimate nearer than this to an instance is of that instance
MIN_VISIBLE = 0.5  # instances that are occluded by less than half have to be found


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseVerdicts:
    """The verdicts on the estimates of one scene.

    Attributes:
        scores: (E,) confidence.
        claims: (E,) int64 true instance that each estimate is of, -1 for none.
        correct: (E,) bool right: the best-scored estimate of an instance that has to be found.
        excused: (E,) bool neither right nor wrong: the best-scored one of an instance that need not be found.
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

    Each estimate is of its nearest instance, or of none if that is ``max_distance`` away or more. Of several of one
    instance the best-scored (of equals the first) is right, or excused if the instance need not be found; the others
    are duplicates, which are wrong, as are those of no instance.

    Bregier's script takes the nearest duplicate for the right one, which counts the same at every score, and lets a
    nearer estimate of another instance take an instance from its own estimate, as can happen between parts that lie
    closer than twice ``max_distance``; here it keeps its own.

    Args:
        distances: (E, P) from each estimate to each true instance [m], of `PoseSpace.distances` with a ``max_distance``
            of `MAX_DISTANCE` times the diameter, or of `recognition_distances` with an infinite one; an infinite
            distance is never a match.
        scores: (E,) confidence.
        to_find: (P,) bool; see `visible_enough`.
        max_distance: [m].

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
    """Return (P,) which instances have to be found: those whose visible fraction is ``min_visible`` or more."""
    enough: NDArray[np.bool_] = visible_fractions >= min_visible
    return enough


def pose_precision_recall(scenes: Sequence[PoseVerdicts], *, pooled: bool = False) -> PrecisionRecall:
    """Return precision and recall for every score of ``scenes``, by ascending score.

    Bregier's curve is the mean over scenes of each scene's precision (1 where it accepts nothing) and recall at the
    same score; ``pooled`` counts the estimates and instances of all scenes together instead. Scenes with nothing to
    find have no recall and are left out of its mean (Bregier's script gives them recall 1).

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
    """Return the area under a curve of `pose_precision_recall` as Bregier takes it; NaN without an instance to find.

    The sum of precision times the step in recall that it was reached by, not interpolated: unlike ScanNet's average
    precision of segments.
    """
    steps = np.diff(curve.recall[::-1], prepend=0.0)
    return float(steps @ curve.precision[::-1])


def _accepted(scores: Floats, thresholds: Floats) -> Floats:
    """Return the (K,) number of ``scores`` that are at least each threshold."""
    return (len(scores) - np.searchsorted(np.sort(scores), thresholds, side="left")).astype(np.float64)
