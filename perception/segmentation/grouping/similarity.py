"""Grouping of points by their embedding, independent of their order and without an N x N matrix."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception.geometry import Floats, require_shape
from perception.segmentation.grouping import _kernels
from perception.segmentation.networks.distance import Distance, squared_threshold

Ints = NDArray[np.int64]

_DIRECTIONS = 96  # directions along which the extent of a group is bounded
# Every direction is within acos(1 / 1.024) of one of them, so a distance exceeds the extent by at most 2.4 %.
EXTENT_TOLERANCE = 0.024


@dataclass(frozen=True, kw_only=True)
class GroupingConfig:
    """Settings of the grouping.

    Attributes:
        threshold: Embedding distance under which points are similar; between the margins M1 and M2 of training.
        distance: ``l2``, or ``scaled_square`` for 10 times the square as in SGPN's code.
        d_max: Whether the distance mask is on (section III.C of the paper).
        slack: Share of ``d_max`` added to the reach of the mask, for measured points (noise adds up to 0.012).
        min_points: Number of points of the smallest group.
        min_confidence: Confidence from which on a point may start a group.
        refinements: Number of times that a proposal is repeated around its mean.
        leftovers: Group of a point that is similar to no group: the one with the nearest mean, or none.
        max_seeds: Largest number of proposals, which bounds the time that an untrained embedding takes.
    """

    threshold: float = 9.0
    distance: Distance = "l2"
    d_max: bool = True
    slack: float = 0.02
    min_points: int = 90
    min_confidence: float = 0.0
    refinements: int = 4
    leftovers: Literal["nearest", "none"] = "nearest"
    max_seeds: int = 500

    def __post_init__(self) -> None:
        squared_threshold(self.threshold, self.distance)
        if not 0 <= self.slack < np.inf:
            raise ValueError(f"slack must be 0 or more and finite, got {self.slack}")
        if self.leftovers not in ("nearest", "none"):
            raise ValueError(f"leftovers must be 'nearest' or 'none', got {self.leftovers!r}")
        if not 0 <= self.min_confidence <= 1:
            raise ValueError(f"min_confidence must be in [0, 1], got {self.min_confidence}")
        for name, least in (("min_points", 1), ("refinements", 0), ("max_seeds", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be {least} or more, got {getattr(self, name)}")


@dataclass(frozen=True, eq=False, kw_only=True)
class Groups:
    """A partition of the points; a point may have no group.

    Attributes:
        labels: (N,) int64 group of each point, -1 for none.
        scores: (G,) float64 mean confidence of the points of each group, in [0, 1].
    """

    labels: Ints
    scores: Floats


def half_sphere(count: int) -> Floats:
    """Return (3, count) unit vectors spread evenly over a half sphere (Fibonacci lattice)."""
    k = np.arange(count)
    z, turn = (k + 0.5) / count, k * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z])


def group_points(
    embedding: NDArray[np.floating],
    confidence: NDArray[np.floating],
    points: NDArray[np.floating],
    d_max: float,
    config: GroupingConfig,
) -> Groups:
    """Group all points of a scene by embedding distance, best confidence first.

    It replaces SGPN's GroupMerging (:mod:`perception.segmentation.grouping.group_merging`), which depends on the order
    of the points. It also extends the distance mask of section III.C of the paper to every pair of points of a group.

    1. The most confident unassigned point is a seed. It proposes the unassigned points within the threshold and within
       ``d_max`` of it. The proposal is repeated ``refinements`` times around its mean embedding, then trimmed, from
       its median outwards, to extents of ``d_max`` in 96 directions. A proposal of at least ``min_points`` points is a
       group. The points of a smaller one are never seeds again.
    2. Every point, by descending confidence, is assigned to the nearest mean within the threshold whose group keeps
       these extents.
    3. The other points are assigned likewise without a threshold, or stay without a group. Groups that are now smaller
       than ``min_points`` are dissolved, and steps 2 and 3 are repeated.

    The embedding may contain votes: a point plus its offset to the centre of its part.

    Args:
        embedding: (N, F) embedding of the points; the computation is in float32.
        confidence: (N,) confidence of the points in [0, 1].
        points: (N, 3) points in any frame [m].
        d_max: Largest extent of the part [m]; infinite for no bound.
        config: Settings of the grouping.

    Returns:
        Groups in the order of their seeds. No two points of a group are farther apart than
        ``d_max * (1 + slack) * (1 + EXTENT_TOLERANCE)``. Points that fit into no group have label -1.

    Raises:
        ValueError: Shapes do not agree, a value is not finite, a confidence is outside [0, 1] or ``d_max`` is not
            positive.

    Note:
        Time is O(N * groups), memory O(N * F). The result is deterministic and independent of the order of the points,
        to the bit: they are first sorted by confidence, coordinates and embedding, so equal ones are interchangeable.
    """
    embedding, confidence, points = require_points(embedding, confidence, points, d_max)
    square = squared_threshold(config.threshold, config.distance)
    reach = float(d_max) * (1 + config.slack) if config.d_max else np.inf
    order = _canonical_order(confidence, points, embedding)
    embedding, confidence, points = embedding[order], confidence[order], points[order]
    directions = half_sphere(_DIRECTIONS)
    labels, means = _kernels.seed_groups(
        embedding,
        points,
        int(np.count_nonzero(confidence >= config.min_confidence)),
        square,
        reach,
        directions,
        config.refinements,
        config.min_points,
        config.max_seeds,
    )
    nearest = config.leftovers == "nearest"
    while True:
        columns = np.ascontiguousarray(means.T)
        final = _kernels.assign_points(embedding, points, labels, columns, square, reach, directions, nearest)
        stays = np.bincount(final[final >= 0], minlength=len(means)) >= config.min_points
        if stays.all():
            break
        labels = np.append(np.where(stays, np.cumsum(stays) - 1, -1), -1)[labels]
        means = means[stays]
    unsorted = np.empty_like(final)
    unsorted[order] = final
    return Groups(labels=unsorted, scores=mean_scores(final, confidence, len(means)))


def require_points(
    embedding: NDArray[np.floating], confidence: NDArray[np.floating], points: NDArray[np.floating], d_max: float
) -> tuple[NDArray[np.float32], Floats, Floats]:
    """Return embedding, confidence and points as contiguous float32, float64 and float64.

    Raises:
        ValueError: Shapes do not agree, a value is not finite, a confidence is outside [0, 1] or ``d_max`` is not
            positive.
    """
    require_shape("points", points, (None, 3))
    count = len(points)
    require_shape("embedding", embedding, (count, None))
    require_shape("confidence", confidence, (count,))
    if embedding.shape[1] == 0:
        raise ValueError(f"embedding must have at least one dimension, got {embedding.shape}")
    for name, array in (("embedding", embedding), ("confidence", confidence), ("points", points)):
        require_finite(name, array)
    if count and not (confidence.min() >= 0 and confidence.max() <= 1):
        raise ValueError(f"confidence must be in [0, 1], got {confidence.min()} to {confidence.max()}")
    if not d_max > 0:
        raise ValueError(f"d_max must be positive, got {d_max}")
    return (
        np.ascontiguousarray(embedding, np.float32),
        np.ascontiguousarray(confidence, np.float64),
        np.ascontiguousarray(points, np.float64),
    )


def require_finite(name: str, array: NDArray[np.floating]) -> None:
    """Raise a ``ValueError`` that names the first point of an (N, ...) array that is not finite."""
    finite = np.isfinite(array)
    if not finite.all():
        bad = int(np.nonzero(~finite)[0][0])
        raise ValueError(f"{name} must be finite, point {bad} is {array[bad].tolist()}")


def mean_scores(labels: Ints, confidence: Floats, groups: int) -> Floats:
    """Return the (groups,) mean confidence of the points of each group; no group may be empty."""
    labelled = labels >= 0
    counts = np.bincount(labels[labelled], minlength=groups)
    sums = np.bincount(labels[labelled], weights=confidence[labelled], minlength=groups)
    return np.clip(sums / counts, 0.0, 1.0)


def propagate_labels(
    points: NDArray[np.floating], subset_idx: Ints, subset_labels: Ints, max_distance: float = np.inf
) -> Ints:
    """Return labels for all points of a cloud, each that of the nearest point of a labelled subset.

    Args:
        points: (N, 3) points [m].
        subset_idx: (M,) indices of the labelled points.
        subset_labels: (M,) labels of the subset; -1, for none, is propagated like any other label.
        max_distance: Distance to the nearest labelled point above which a point gets -1 [m].

    Returns:
        (N,) int64 labels. Labelled points keep theirs, and all are -1 if the subset is empty.

    Raises:
        ValueError: Shapes do not agree, an index is out of range, a point is not finite or ``max_distance`` is
            negative.
    """
    require_shape("points", points, (None, 3))
    require_shape("subset_idx", subset_idx, (None,))
    require_shape("subset_labels", subset_labels, (len(subset_idx),))
    require_finite("points", points)
    if not max_distance >= 0:
        raise ValueError(f"max_distance must be 0 or more, got {max_distance}")
    labels = np.full(len(points), -1, np.int64)
    if len(subset_idx) == 0:
        return labels
    if subset_idx.min() < 0 or subset_idx.max() >= len(points):
        raise ValueError(f"subset_idx must be in [0, {len(points)}), got {subset_idx.min()} to {subset_idx.max()}")
    distances, nearest = cKDTree(points[subset_idx]).query(points)
    within = distances <= max_distance
    labels[within] = subset_labels[np.asarray(nearest)[within]]
    labels[subset_idx] = subset_labels
    return labels


def _canonical_order(confidence: Floats, points: Floats, embedding: NDArray[np.float32]) -> Ints:
    """Return the (N,) indices that sort by descending confidence, then by coordinates, then by embedding."""
    order = np.argsort(-confidence, kind="stable")
    keys: tuple[NDArray[np.floating], ...] = (-confidence,)
    for further in (tuple(points.T), tuple(embedding.T)):
        ranks = np.stack([key[order] for key in keys])
        new = np.append(True, (ranks[:, 1:] != ranks[:, :-1]).any(axis=0))[: len(order)]
        tied = np.flatnonzero(~(new & np.append(new[1:], True)))
        if len(tied) == 0:
            break
        run = np.cumsum(new)[tied]
        rows = order[tied]
        order[tied] = rows[np.lexsort((*(key[rows] for key in reversed(further)), run))]
        keys += further
    return order
