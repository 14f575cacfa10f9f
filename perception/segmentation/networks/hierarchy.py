"""Inputs of the context network: points at three densities, and their neighbours.

Points are ordered so that the first quarter of them is the second level and the first sixteenth the third one.

Shapes: N points of a level, K neighbours.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception.geometry import Floats

RATIO = 4  # number of points of a level for each point of the next
LEVELS = 3  # number of densities: all points, 1/4 and 1/16 of them
STRATUM = (3.0, 9.0)  # side of the cubes that the points of the second and third level are spread over, in spacings
NEAREST = 3  # number of points of the next level that a feature is interpolated from

Singles = NDArray[np.float32]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Hierarchy:
    """Points of a cloud in the order of their levels, with their neighbours.

    Attributes:
        points: (N, 3) float32 points in units of d_max.
        neighbours: For each level its (N_l, min(k, N_l)) int64 nearest points in the level, the point itself first.
        above: For each level but the last, the (N_l, min(3, N_l+1)) int64 nearest points in the next level.
    """

    points: Singles
    neighbours: tuple[Ints, ...]
    above: tuple[Ints, ...]


def level_sizes(count: int) -> tuple[int, ...]:
    """Return the numbers of points of the levels of a cloud of ``count`` points, at least 1 each."""
    return tuple(max(1, count // RATIO**level) for level in range(LEVELS))


def thin(points: NDArray[np.floating], spacing: float, rng: np.random.Generator) -> Ints:
    """Draw one of the points in each cube of a grid, which evens out the density of a cloud.

    Args:
        points: (N, 3) points.
        spacing: Side of a cube, in the unit of the points.
        rng: Source of the draws.

    Returns:
        (M,) int64 indices in random order.
    """
    order = rng.permutation(len(points))
    chosen: Ints = order[_ranks(points[order], spacing) == 0]
    return chosen


def level_order(points: NDArray[np.floating], spacing: float) -> Ints:
    """Return the (N,) order in which the first points of a cloud are spread evenly over it.

    Args:
        points: (N, 3) points in random order.
        spacing: Distance of neighbouring points, in the unit of the points.
    """
    order = np.arange(len(points))
    for size, side in zip(level_sizes(len(points)), STRATUM, strict=False):
        first = order[:size]
        order[:size] = first[np.argsort(_ranks(points[first], side * spacing), kind="stable")]
    return order


def build_hierarchy(points: NDArray[np.floating], k: int) -> Hierarchy:
    """Return the levels of (N, 3) points in the order of :func:`level_order`, with ``k`` neighbours for each point."""
    single = np.ascontiguousarray(points, np.float32)
    levels = [single[:size] for size in level_sizes(len(single))]
    trees = [cKDTree(level) for level in levels]
    return Hierarchy(
        points=single,
        neighbours=tuple(_nearest(tree, level, k) for tree, level in zip(trees, levels, strict=True)),
        above=tuple(_nearest(tree, level, NEAREST) for tree, level in zip(trees[1:], levels[:-1], strict=True)),
    )


def _nearest(tree: cKDTree, points: Singles, k: int) -> Ints:
    found = tree.query(points, np.arange(1, min(k, tree.n) + 1))[1]
    return np.asarray(found, np.int64)


def _ranks(points: NDArray[np.floating], side: float) -> Ints:
    """Return for each of the (N, 3) points the number of earlier ones in its cube of a grid."""
    cells = np.floor((points - points.min(axis=0)) / side).astype(np.int64)
    spans = cells.max(axis=0) + 1
    keys = (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2]
    order = np.argsort(keys, kind="stable")
    new = np.append(True, np.diff(keys[order]) != 0)
    starts = np.maximum.accumulate(np.where(new, np.arange(len(keys)), 0))
    ranks = np.empty(len(keys), np.int64)
    ranks[order] = np.arange(len(keys)) - starts
    return ranks


def window(points: Floats, focus: int, count: int) -> Ints:
    """Return the at most ``count`` points nearest to point ``focus`` in the image plane, nearest first."""
    squares = np.square(points[:, :2] - points[focus, :2]).sum(axis=1)
    if count < len(squares):
        chosen = np.argpartition(squares, count)[:count]
        return chosen[np.argsort(squares[chosen], kind="stable")]
    return np.argsort(squares, kind="stable")
