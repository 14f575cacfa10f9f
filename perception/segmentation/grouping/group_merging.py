"""SGPN's GroupMerging: proposals merged in the order of the points, the paper's baseline."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from perception.geometry import Floats, require_shape
from perception.segmentation.grouping.similarity import Groups, Ints, mean_scores, require_points
from perception.segmentation.networks.distance import Distance, squared_threshold

Mask = NDArray[np.bool_]

_ROWS = 256


@dataclass(frozen=True, kw_only=True)
class GroupMergingConfig:
    """The constants of the released code, but for the threshold, which it takes from a faulty histogram.

    Attributes:
        threshold: Embedding distance under which points are one proposal.
        distance: ``l2``, or ``scaled_square`` for 10 times the square, which is the released code's.
        min_confidence: A point must be more confident to propose.
        min_proposal: A proposal must have more points.
        iou: Two proposals that overlap by more are one.
        share: So they are if the newer has more than this part of its points in the older.
        min_points: A proposal is painted if it has more points, and kept if it is left with so many.
        leftovers: Unassigned points take the mode of the groups of the points similar to them (the released code), of
            their nearest labelled points in space, or stay alone.
        neighbours: That many nearest points.
    """

    threshold: float = 7.5
    distance: Distance = "l2"
    min_confidence: float = 0.4
    min_proposal: int = 5
    iou: float = 0.6
    share: float = 0.8
    min_points: int = 50
    leftovers: Literal["similar", "nearest", "none"] = "similar"
    neighbours: int = 8

    def __post_init__(self) -> None:
        squared_threshold(self.threshold, self.distance)
        for name in ("min_confidence", "iou", "share"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be in [0, 1], got {getattr(self, name)}")
        for name, least in (("min_proposal", 0), ("min_points", 1), ("neighbours", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be {least} or more, got {getattr(self, name)}")
        if self.leftovers not in ("similar", "nearest", "none"):
            raise ValueError(f"leftovers must be 'similar', 'nearest' or 'none', got {self.leftovers!r}")


def merge_groups(
    embedding: NDArray[np.floating],
    confidence: NDArray[np.floating],
    points: NDArray[np.floating],
    config: GroupMergingConfig,
    *,
    d_max: float | None = None,
    classes: Ints | None = None,
) -> Groups:
    """Group points as SGPN's released ``GroupMerging`` does, one class after the other.

    Each confident point, in index order, proposes the points of its class whose row of the similarity matrix S is
    under the threshold. A proposal that is one with older ones replaces those smaller than itself, any other is added;
    a class without proposals is one. They are painted in order, later ones over earlier ones. Differs in the
    threshold and in the optional distance mask; and S is computed in blocks of rows.

    Args:
        embedding: (N, F).
        confidence: (N,) in [0, 1].
        points: (N, 3) [m], any frame.
        config: The constants.
        d_max: The distance mask: entries of S between points farther apart are out [m]; None for no mask.
        classes: (N,) semantic class, -1 for points to leave out; None for one class.

    Returns:
        Groups; the scores are the mean confidence of their points. A point without neighbours in a group stays -1.

    Raises:
        ValueError: A shape, a value that is not finite, a confidence outside [0, 1] or d_max <= 0.

    Note:
        The result depends on the order of the points: by nature, not by mistake. Meant for N up to 4096; time is
        O(N^2 (F + proposals)), memory N^2 bytes at worst.
    """
    embedding, confidence, points = require_points(embedding, confidence, points, np.inf if d_max is None else d_max)
    if classes is None:
        classes = np.zeros(len(points), np.int64)
    require_shape("classes", classes, (len(points),))
    similarity = _Similarity(embedding, points, squared_threshold(config.threshold, config.distance), d_max)
    labels = np.full(len(points), -1, np.int64)
    painted = 0
    for kind in np.unique(classes[classes >= 0]):
        for proposal in _proposals(similarity, confidence, classes == kind, config):
            if np.count_nonzero(proposal) > config.min_points:
                labels[proposal] = painted
                painted += 1
    counts = np.bincount(labels[labels >= 0], minlength=painted)
    kept = counts >= config.min_points
    labels = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)[labels]
    alone = np.flatnonzero((labels < 0) & (classes >= 0))
    if kept.any() and config.leftovers == "similar":
        _join_similar(labels, alone, similarity)
    elif kept.any() and config.leftovers == "nearest":
        _join_nearest(labels, alone, points, config.neighbours, d_max)
    return Groups(labels=labels, scores=mean_scores(labels, confidence, int(kept.sum())))


@dataclass(frozen=True, eq=False)
class _Similarity:
    """The similarity matrix under its threshold, row by row."""

    embedding: NDArray[np.float32]
    points: Floats
    square: float
    d_max: float | None

    def rows(self, indices: Ints) -> Mask:
        """Return the (R, N) points that are in one proposal with each of (R,) ``indices``."""
        similar: Mask = cdist(self.embedding[indices], self.embedding, "sqeuclidean") < self.square
        if self.d_max is not None:
            similar &= cdist(self.points[indices], self.points) <= self.d_max
        return similar


def _proposals(similarity: _Similarity, confidence: Floats, members: Mask, config: GroupMergingConfig) -> Mask:
    """Return the (G, N) merged proposals of the class of (N,) ``members``."""
    seeds = np.flatnonzero(members & (confidence > config.min_confidence))
    proposals = np.zeros((len(seeds) + 1, len(members)), np.bool_)
    count = 0
    for start in range(0, len(seeds), _ROWS):
        for proposal in similarity.rows(seeds[start : start + _ROWS]) & members:
            if np.count_nonzero(proposal) > config.min_proposal:
                count = _merge(proposals, count, proposal, config)
    if count == 0:
        proposals[0] = members
        count = 1
    return proposals[:count]


def _merge(proposals: Mask, count: int, proposal: Mask, config: GroupMergingConfig) -> int:
    """Merge (N,) ``proposal`` into the first ``count`` rows, or add it after them; return the new count."""
    older = proposals[:count]
    size, sizes = np.count_nonzero(proposal), np.count_nonzero(older, axis=1)
    shared = np.count_nonzero(older[:, np.flatnonzero(proposal)], axis=1)
    one = (shared / (size + sizes - shared) > config.iou) | (shared / size > config.share)
    older[one & (size > sizes)] = proposal
    if one.any():
        return count
    proposals[count] = proposal
    return count + 1


def _join_similar(labels: Ints, alone: Ints, similarity: _Similarity) -> None:
    """Label each of ``alone``, in order and in place, by the mode of the labels of the points similar to it."""
    for start in range(0, len(alone), _ROWS):
        block = alone[start : start + _ROWS]
        for i, similar in zip(block, similarity.rows(block), strict=True):
            labels[i] = _mode(labels[similar])


def _join_nearest(labels: Ints, alone: Ints, points: Floats, neighbours: int, d_max: float | None) -> None:
    """Label ``alone`` in place by the mode of their nearest labelled points, of those within d_max."""
    labelled = np.flatnonzero(labels >= 0)
    reach = np.inf if d_max is None else np.nextafter(d_max, np.inf)
    _, nearest = cKDTree(points[labelled]).query(
        points[alone], k=np.arange(min(neighbours, len(labelled))) + 1, distance_upper_bound=reach
    )
    found = np.append(labels[labelled], -1)[nearest]
    labels[alone] = [_mode(row) for row in found]


def _mode(labels: Ints) -> int:
    """Return the most frequent label that is not -1, the smallest of several, or -1 if there is none."""
    given = labels[labels >= 0]
    return int(np.bincount(given).argmax()) if len(given) else -1
