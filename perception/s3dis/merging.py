"""SGPN's BlockMerging: the groups of overlapping blocks become the objects of a room."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, require_shape
from perception.instance import Instance
from perception.s3dis.data.categories import CATEGORIES

Ints = NDArray[np.int64]
MIN_SIZE_SHARE = 0.25  # smallest size of a predicted object, as a share of the mean of its category (released code)
_C = len(CATEGORIES)


@dataclass(frozen=True, kw_only=True)
class MergeConfig:
    """Settings of SGPN's BlockMerging (Wang et al., CVPR 2018, and the released code).

    Attributes:
        cell: Side of a cell of the grid that stores the objects [m]. The released code divides each extent of the room
            by 200, which gives 3 cm in a room of 6 m, but 20 cm along a hallway of 40 m.
        min_hits: Number of points of a group that must lie in cells of an object for the group to join it. It joins the
            object with most points.
        min_points: Number of points above which a group that joins no object starts a new one.
        exclusive: Whether at most one group of a sample, the one with most points, joins an object, so that two chairs
            that touch stay separate. In the released code any number of groups joins.
        rejoin: Whether objects are fused in the end if more points support it than contradict it, see
            :class:`BlockMerger`. In the released code, a floor that was first seen on both sides of a sofa stays two
            objects.
    """

    cell: float = 0.03
    min_hits: int = 7
    min_points: int = 30
    exclusive: bool = True
    rejoin: bool = True

    def __post_init__(self) -> None:
        if not self.cell > 0:
            raise ValueError(f"cell must be positive, got {self.cell}")
        if self.min_hits < 1 or self.min_points < 0:
            raise ValueError(
                f"min_hits must be at least 1 and min_points 0 or more, got {self.min_hits} and {self.min_points}"
            )


@dataclass(frozen=True, eq=False, kw_only=True)
class SampleGroups:
    """Groups found in a sample of a block.

    Attributes:
        point_idx: (M,) distinct indices into the points of the room.
        groups: (M,) group of each point, -1 for none.
        categories: (M,) predicted category of each point.
        confidences: (M,) confidence of each point in [0, 1].
    """

    point_idx: Ints
    groups: Ints
    categories: Ints
    confidences: NDArray[np.floating]

    def __post_init__(self) -> None:
        require_shape("point_idx", self.point_idx, (None,))
        for name in ("groups", "categories", "confidences"):
            require_shape(name, getattr(self, name), (len(self.point_idx),))
        low, high = self.categories.min(initial=0), self.categories.max(initial=0)
        if low < 0 or high >= _C:
            raise ValueError(f"categories must be 0 to {_C - 1}, got {low} to {high}")
        if len(np.unique(self.point_idx)) < len(self.point_idx):
            raise ValueError("point_idx of a sample must not repeat")


class BlockMerger:
    """Merges the groups of samples, in the order of their blocks, into the objects of a room.

    A cell stores one object for each category, the first that was there, so a cell of a board on a wall stores both.
    The category of a group is that of most of its points. A point keeps the first object that it is assigned to.

    Differs from the released code, which assigns a group with few hits and few points to object 0 (here it is dropped),
    holds at most 100 groups and 300 objects, wraps object ids at 256, forgets one of two categories in a cell, can fuse
    touching objects of a category within a sample, and never fuses an object that was started at both ends.
    """

    def __init__(self, xyz: NDArray[np.float32], config: MergeConfig | None = None) -> None:
        """Prepare for a room.

        Args:
            xyz: (N, 3) points of the room [m].
            config: Settings of the merging; the defaults of :class:`MergeConfig` if left out.
        """
        require_shape("xyz", xyz, (None, 3))
        self._config = config or MergeConfig()
        self._cell_of_point, cells = _cells(xyz, self._config.cell)
        self._owner = np.full(cells * _C, -1, np.int64)  # object of each cell and category
        self._labels = np.full(len(xyz), -1, np.int64)
        self._votes = np.zeros((0, _C), np.int64)  # number of points of each object by category
        self._confidence = np.zeros(0)  # sum of the confidences of each object
        self._support = Counter[tuple[int, int]]()  # points for minus points against the fusion of two objects

    @property
    def labels(self) -> Ints:
        """The (N,) object of each point, -1 for none."""
        return self._fused(self._roots())

    def add(self, sample: SampleGroups) -> None:
        """Merge the groups of the next sample."""
        grouped = sample.groups >= 0
        if not grouped.any():
            return
        point_idx, groups = sample.point_idx[grouped], sample.groups[grouped]
        votes = np.bincount(groups * _C + sample.categories[grouped], minlength=(groups.max() + 1) * _C).reshape(-1, _C)
        category = votes.argmax(axis=1)
        layer = self._cell_of_point[point_idx] * _C + category[groups]
        hits = _hits(groups, self._owner[layer], self._config.min_hits)
        sizes = np.bincount(groups)
        objects = self._objects(hits, sizes)
        self._count_support(hits, objects, category, sizes)
        rows = objects[groups] >= 0
        given = objects[groups[rows]]
        self._count(given, sample.categories[grouped][rows], sample.confidences[grouped][rows])
        for memory, place in ((self._labels, point_idx[rows]), (self._owner, layer[rows])):
            free = memory[place] < 0
            memory[place[free][::-1]] = given[free][::-1]  # reversed, so that the first of equal places is kept

    def instances(self, min_sizes: Floats | None = None) -> list[Instance]:
        """Return the objects, best confidence first.

        The label of an object is the mode, its score the mean, over its points in all samples.

        Args:
            min_sizes: (C,) smallest number of points of an object of each category; no limit unless given.
        """
        if min_sizes is not None:
            require_shape("min_sizes", min_sizes, (_C,))
        roots = self._roots()
        votes, confidence = np.zeros_like(self._votes), np.zeros_like(self._confidence)
        np.add.at(votes, roots, self._votes)
        np.add.at(confidence, roots, self._confidence)
        categories, scores = votes.argmax(axis=1), confidence / np.maximum(votes.sum(axis=1), 1)
        found = [
            Instance(point_idx=idx, score=float(scores[k]), label=int(categories[k]))
            for k, idx in _members(self._fused(roots), len(scores))
            if min_sizes is None or len(idx) >= min_sizes[categories[k]]
        ]
        return sorted(found, key=lambda instance: -instance.score)

    def _fused(self, roots: Ints) -> Ints:
        labels: Ints = np.append(roots, -1)[self._labels]
        return labels

    def _objects(self, hits: Ints, sizes: Ints) -> Ints:
        """Return the (G,) object of each group, -1 for a dropped group; new objects are numbered by group."""
        objects = np.full(len(sizes), -1, np.int64)
        group, first = np.unique(hits[:, 0], return_index=True)
        owner, most = hits[first, 1], hits[first, 2]
        if self._config.exclusive:
            order = np.lexsort((group, -most))
            first = order[np.unique(owner[order], return_index=True)[1]]
            group, owner = group[first], owner[first]
        objects[group] = owner
        begins = np.flatnonzero((objects < 0) & (sizes > self._config.min_points))
        objects[begins] = len(self._votes) + np.arange(len(begins))
        self._votes = np.concatenate([self._votes, np.zeros((len(begins), _C), np.int64)])
        self._confidence = np.concatenate([self._confidence, np.zeros(len(begins))])
        return objects

    def _count_support(self, hits: Ints, objects: Ints, category: Ints, sizes: Ints) -> None:
        """Count the points that support and contradict the fusion of objects."""
        for group in np.flatnonzero(np.bincount(hits[:, 0]) > 1):
            mine = hits[hits[:, 0] == group]
            for (_, a, n), (_, b, m) in combinations(mine.tolist(), 2):
                self._support[min(a, b), max(a, b)] += min(n, m)
        present = [(k, objects[k], category[k]) for k in np.flatnonzero(objects >= 0).tolist()]
        for (g, a, c), (h, b, d) in combinations(present, 2):
            if a != b and c == d:
                self._support[int(min(a, b)), int(max(a, b))] -= int(min(sizes[g], sizes[h]))

    def _roots(self) -> Ints:
        """Return the (K,) object that each object is fused with, by greedy fusion of the best supported pair."""
        roots = np.arange(len(self._votes))
        support = self._support if self._config.rejoin else Counter[tuple[int, int]]()
        while support:
            (first, second), points = max(support.items(), key=lambda item: (item[1], -item[0][0], -item[0][1]))
            if points <= 0:
                break
            roots[roots == second] = first
            summed = Counter[tuple[int, int]]()
            for pair, n in support.items():
                a, b = sorted(first if k == second else k for k in pair)
                if a != b:
                    summed[a, b] += n
            support = summed
        return roots

    def _count(self, objects: Ints, categories: Ints, confidences: NDArray[np.floating]) -> None:
        number = len(self._votes)
        self._votes = self._votes + np.bincount(objects * _C + categories, minlength=number * _C).reshape(-1, _C)
        self._confidence = self._confidence + np.bincount(objects, weights=confidences, minlength=number)


def _cells(xyz: NDArray[np.float32], side: float) -> tuple[Ints, int]:
    """Return the (N,) index of each point's cell among the occupied cells, and their number."""
    place = ((xyz - xyz.min(axis=0).astype(np.float64)) / side).astype(np.int64)
    shape = place.max(axis=0) + 1
    keys = (place[:, 0] * shape[1] + place[:, 1]) * shape[2] + place[:, 2]
    found, index = np.unique(keys, return_inverse=True)
    return index.astype(np.int64), len(found)


def _hits(groups: Ints, owners: Ints, least: int) -> Ints:
    """Return rows (group, object, number of shared points of at least ``least``), by group, most points first."""
    hit = owners >= 0
    width = owners.max(initial=0) + 1
    keys, hits = np.unique(groups[hit] * width + owners[hit], return_counts=True)
    rows = np.column_stack([keys // width, keys % width, hits])[hits >= least]
    return rows[np.lexsort((rows[:, 1], -rows[:, 2], rows[:, 0]))]


def _members(labels: Ints, number: int) -> Iterator[tuple[int, Ints]]:
    """Yield each label below ``number`` that occurs, with the ascending indices of its points."""
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(number + 1))
    for k in range(number):
        if starts[k + 1] > starts[k]:
            yield k, order[starts[k] : starts[k + 1]]
