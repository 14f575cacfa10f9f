"""What segmentation delivers: groups of boundary points that are one part each."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import require_shape


@dataclass(frozen=True, eq=False, kw_only=True)
class Instance:
    """The boundary points of one part.

    Attributes:
        point_idx: (M,) int64 ascending indices into the boundary cloud.
        score: Confidence in [0, 1]; instances are ranked by it.
        label: Semantic class; parts of a bin are all of class 0.
    """

    point_idx: NDArray[np.int64]
    score: float
    label: int = 0

    def __post_init__(self) -> None:
        require_shape("point_idx", self.point_idx, (None,))
        if not np.isfinite(self.score):
            raise ValueError(f"score must be finite, got {self.score}")


def labels_of(instances: Sequence[Instance], count: int) -> NDArray[np.int64]:
    """Return the (count,) index of each point's instance, -1 for none; of overlapping ones the first counts."""
    labels = np.full(count, -1, np.int64)
    for k in reversed(range(len(instances))):
        labels[instances[k].point_idx] = k
    return labels


def instances_of(labels: NDArray[np.int64], scores: NDArray[np.floating] | Sequence[float]) -> list[Instance]:
    """Return an instance for each k below ``len(scores)`` that (N,) ``labels`` name, best score first; -1 is no one's.

    Raises:
        ValueError: A label has no score.
    """
    require_shape("labels", labels, (None,))
    if labels.max(initial=-1) >= len(scores):
        raise ValueError(f"labels go up to {labels.max()}, but there are {len(scores)} scores")
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(len(scores) + 1))
    found = [
        Instance(point_idx=order[starts[k] : starts[k + 1]], score=float(scores[k]))
        for k in range(len(scores))
        if starts[k + 1] > starts[k]
    ]
    return sorted(found, key=lambda instance: -instance.score)


def true_instances(part_ids: NDArray[np.int64], min_points: int) -> list[Instance]:
    """Return the true segments, all of score 1: the points of each part that has at least ``min_points`` of (N,).

    Args:
        part_ids: (N,) part that each point lies on, -1 for none.
        min_points: Smallest segment.
    """
    found = instances_of(part_ids, np.ones(part_ids.max(initial=-1) + 1))
    return [instance for instance in found if len(instance.point_idx) >= min_points]
