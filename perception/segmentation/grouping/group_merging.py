"""SGPN's GroupMerging, the paper's baseline: proposals are merged in the order of the points."""

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
    """Constants of the released code. Its threshold comes from a faulty histogram, so ours differs.

    Attributes:
        threshold: Embedding distance under which points belong to one proposal.
        distance: ``l2``, or ``scaled_square`` for 10 times the square as in the released code.
        min_confidence: Confidence above which a point makes a proposal.
        min_proposal: Number of points above which a proposal counts.
        iou: IoU above which two proposals are merged.
        share: Share of the newer proposal's points in the older one above which the two are merged.
        min_points: Number of points above which a proposal becomes a group, and from which on the group is kept after
            later groups have overwritten points of it.
        leftovers: Group of an unassigned point: the mode over the points similar to it as in the released code
            (``similar``), the mode over its nearest labelled points in space (``nearest``), or none.
        neighbours: Number of nearest points for ``nearest``.
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

    Each confident point, in index order, proposes the points of its class whose entry in its row of the similarity
    matrix S is under the threshold. A proposal that overlaps older ones replaces those smaller than itself; any other
    proposal is added. A class without proposals is one proposal. Proposals become groups in order, and later ones
    overwrite earlier ones. Differs from the released code in the threshold and in the optional distance mask, and
    computes S in blocks of rows.

    Args:
        embedding: (N, F) embedding of the points.
        confidence: (N,) confidence of the points in [0, 1].
        points: (N, 3) points in any frame [m].
        config: Constants of the method.
        d_max: Distance mask: points farther apart are never similar [m]; None for no mask.
        classes: (N,) semantic class of each point, -1 for points to leave out; None for one class.

    Returns:
        Groups, scored by the mean confidence of their points. A point without neighbours in a group stays -1.

    Raises:
        ValueError: Shapes do not agree, a value is not finite, a confidence is outside [0, 1] or ``d_max`` is not
            positive.

    Note:
        The method depends on the order of the points. It is meant for N up to 4096: time is O(N^2 (F + proposals)),
        memory at most N^2 bytes.
    """
    embedding, confidence, points = require_points(embedding, confidence, points, np.inf if d_max is None else d_max)
    if classes is None:
        classes = np.zeros(len(points), np.int64)
    require_shape("classes", classes, (len(points),))
    similarity = _Similarity(embedding, points, squared_threshold(config.threshold, config.distance), d_max)
    labels = np.full(len(points), -1, np.int64)
    groups = 0
    for kind in np.unique(classes[classes >= 0]):
        for proposal in _proposals(similarity, confidence, classes == kind, config):
            if np.count_nonzero(proposal) > config.min_points:
                labels[proposal] = groups
                groups += 1
    counts = np.bincount(labels[labels >= 0], minlength=groups)
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
    """The thresholded similarity matrix, computed row by row."""

    embedding: NDArray[np.float32]
    points: Floats
    square: float
    d_max: float | None

    def rows(self, indices: Ints) -> Mask:
        """Return the (R, N) mask of the points similar to each of (R,) ``indices``."""
        similar: Mask = cdist(self.embedding[indices], self.embedding, "sqeuclidean") < self.square
        if self.d_max is not None:
            similar &= cdist(self.points[indices], self.points) <= self.d_max
        return similar


def _proposals(similarity: _Similarity, confidence: Floats, members: Mask, config: GroupMergingConfig) -> Mask:
    """Return the (G, N) merged proposals of a class, whose points are the (N,) mask ``members``."""
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
    """Label the points ``alone`` one after the other, in place, by the mode over the points similar to each."""
    for start in range(0, len(alone), _ROWS):
        block = alone[start : start + _ROWS]
        for i, similar in zip(block, similarity.rows(block), strict=True):
            labels[i] = _mode(labels[similar])


def _join_nearest(labels: Ints, alone: Ints, points: Floats, neighbours: int, d_max: float | None) -> None:
    """Label the points ``alone`` in place by the mode over their nearest labelled points within ``d_max``."""
    labelled = np.flatnonzero(labels >= 0)
    reach = np.inf if d_max is None else np.nextafter(d_max, np.inf)
    _, nearest = cKDTree(points[labelled]).query(
        points[alone], k=np.arange(min(neighbours, len(labelled))) + 1, distance_upper_bound=reach
    )
    found = np.append(labels[labelled], -1)[nearest]
    labels[alone] = [_mode(row) for row in found]


def _mode(labels: Ints) -> int:
    """Return the most frequent label that is not -1 (the smallest of equally frequent ones), or -1 if there is none."""
    given = labels[labels >= 0]
    return int(np.bincount(given).argmax()) if len(given) else -1
