"""Instances: groups of boundary points, each on one part."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import require_shape


@dataclass(frozen=True, eq=False, kw_only=True)
class Instance:
    """The boundary points of one visible part.

    Attributes:
        point_idx: (M,) int64 indices into the boundary cloud, ascending.
        score: Confidence in [0, 1], by which instances are ranked.
        label: Semantic class; 0 for every part of a bin.
    """

    point_idx: NDArray[np.int64]
    score: float
    label: int = 0

    def __post_init__(self) -> None:
        require_shape("point_idx", self.point_idx, (None,))
        if not np.isfinite(self.score):
            raise ValueError(f"score must be finite, got {self.score}")


def labels_of(instances: Sequence[Instance], count: int) -> NDArray[np.int64]:
    """Return the (count,) index of each point's instance, -1 for none; the first of overlapping instances wins.

    Args:
        instances: Groups of points, the preferred one first.
        count: Number of points.
    """
    labels = np.full(count, -1, np.int64)
    for k in reversed(range(len(instances))):
        labels[instances[k].point_idx] = k
    return labels


def instances_of(labels: NDArray[np.int64], scores: NDArray[np.floating] | Sequence[float]) -> list[Instance]:
    """Return the instances that have points, best score first.

    Args:
        labels: (N,) index of each point's instance, -1 for none.
        scores: Confidence of each instance.

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
    """Return the true segments, all of score 1.

    Args:
        part_ids: (N,) part that each point lies on, -1 for none.
        min_points: Number of points from which on a part has a segment.
    """
    found = instances_of(part_ids, np.ones(part_ids.max(initial=-1) + 1))
    return [instance for instance in found if len(instance.point_idx) >= min_points]
