"""Compiled kernels of grouping: arrays in, arrays out, no threads and no fast maths (same arrays, same bits).

Points are sorted by descending confidence, so an index is also a rank.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats

Singles = NDArray[np.float32]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True)
def _similar(embedding: Singles, candidates: Ints, centre: Singles, square: float, out: Ints) -> int:
    """Write the candidates with a squared embedding distance under ``square`` to ``out``; return their number."""
    count = 0
    for i in candidates:
        total = np.float32(0.0)
        for f in range(len(centre)):
            difference = embedding[i, f] - centre[f]
            total += difference * difference
        if total < square:
            out[count] = i
            count += 1
    return count


@njit(cache=True, nogil=True)
def _near(points: Floats, candidates: Ints, centre: Floats, square: float, out: Ints) -> int:
    """Write the candidates with a squared distance in space of at most ``square`` to ``out``; return their number."""
    count = 0
    for i in candidates:
        x, y, z = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
        if x * x + y * y + z * z <= square:
            out[count] = i
            count += 1
    return count


@njit(cache=True, nogil=True)
def _mean(embedding: Singles, members: Ints, out: Singles) -> None:
    total = np.zeros(len(out))
    for i in members:
        for f in range(len(out)):
            total[f] += embedding[i, f]
    for f in range(len(out)):
        out[f] = total[f] / len(members)


@njit(cache=True, nogil=True)
def _extend(low: Floats, high: Floats, point: Floats, directions: Floats, reach: float) -> bool:
    """Widen the (K,) extents to contain ``point``; return False, changing nothing, if one would exceed ``reach``."""
    beyond = 0
    for k in range(len(low)):
        along = point[0] * directions[0, k] + point[1] * directions[1, k] + point[2] * directions[2, k]
        beyond += max(along, high[k]) - min(along, low[k]) > reach
    if beyond > 0:
        return False
    for k in range(len(low)):
        along = point[0] * directions[0, k] + point[1] * directions[1, k] + point[2] * directions[2, k]
        low[k] = min(along, low[k])
        high[k] = max(along, high[k])
    return True


@njit(cache=True, nogil=True)
def _trim(points: Floats, members: Ints, directions: Floats, reach: float) -> int:
    """Move the members whose extents stay within ``reach`` to the front of ``members``; return their number.

    If not all fit, members are added in the order of their distance from the median, unless one exceeds the reach.
    """
    extents = directions.shape[1]
    low, high = np.full(extents, np.inf), np.full(extents, -np.inf)
    whole = True
    for i in members:
        if not _extend(low, high, points[i], directions, reach):
            whole = False
            break
    if whole:
        return len(members)
    # Not all fit: add them again from the median outwards.
    offsets = points[members]
    for axis in range(3):
        offsets[:, axis] -= np.median(offsets[:, axis])
    outwards = np.argsort((offsets * offsets).sum(axis=1), kind="mergesort")
    low[:], high[:] = np.inf, -np.inf
    fits = np.zeros(len(members), np.bool_)
    for m in outwards:
        fits[m] = _extend(low, high, points[members[m]], directions, reach)
    count = 0
    for m in range(len(members)):
        if fits[m]:
            members[count] = members[m]
            count += 1
    return count


@njit(cache=True, nogil=True)
def _propose(embedding: Singles, seed: int, candidates: Ints, square: float, refinements: int, members: Ints) -> int:
    """Write the candidates similar to ``seed``, then ``refinements`` times to their mean, to ``members``.

    Returns:
        Number of members.
    """
    centre = embedding[seed].copy()
    size = _similar(embedding, candidates, centre, square, members)
    for _ in range(refinements):
        if size > 1:
            _mean(embedding, members[:size], centre)
            size = _similar(embedding, candidates, centre, square, members)
    return size


@njit(cache=True, nogil=True)
def seed_groups(
    embedding: Singles,
    points: Floats,
    seeds: int,
    square: float,
    reach: float,
    directions: Floats,
    refinements: int,
    min_points: int,
    max_seeds: int,
) -> tuple[Ints, Singles]:
    """Find one group after the other, each around the first unassigned point.

    Args:
        embedding: (N, F) embedding of the points.
        points: (N, 3) points [m].
        seeds: Number of leading points that may be seeds.
        square: Squared embedding distance under which points are similar.
        reach: Largest extent of a group [m]; infinite for no bound.
        directions: (3, K) unit vectors along which the extent of a group is bounded.
        refinements: Number of times that a proposal is repeated around its mean.
        min_points: Number of points of the smallest group. The points of a smaller proposal are never seeds again.
        max_seeds: Largest number of seeds that are tried.

    Returns:
        (N,) group of each point, -1 for none, and the (G, F) mean embedding of each group.
    """
    count, width = embedding.shape
    labels = np.full(count, -1, np.int64)
    spent = np.zeros(count, np.bool_)
    rest, near, members = np.arange(count), np.empty(count, np.int64), np.empty(count, np.int64)
    left, groups, tried = count, 0, 0
    means = np.empty((max_seeds, width), np.float32)
    masked = reach < np.inf
    for seed in range(seeds):
        if spent[seed] or labels[seed] >= 0:
            continue
        if tried == max_seeds:
            break
        tried += 1
        spent[seed] = True
        # Propose the unassigned points in reach that are similar to the seed.
        candidates = rest[:left]
        if masked:
            candidates = near[: _near(points, candidates, points[seed], reach * reach, near)]
        size = _propose(embedding, seed, candidates, square, refinements, members)
        if masked and size >= min_points:
            size = _trim(points, members[:size], directions, reach)
        if size < min_points:
            spent[members[:size]] = True
            continue
        # Accept the group and take its points out of the rest.
        labels[members[:size]] = groups
        _mean(embedding, members[:size], means[groups])
        groups += 1
        kept = 0
        for i in rest[:left]:
            if labels[i] < 0:
                rest[kept] = i
                kept += 1
        left = kept
    return labels, means[:groups].copy()


@njit(cache=True, nogil=True)
def assign_points(
    embedding: Singles,
    points: Floats,
    core: Ints,
    means: Singles,
    square: float,
    reach: float,
    directions: Floats,
    leftovers: bool,
) -> Ints:
    """Return the (N,) group of each point: the nearest mean whose group has room for the point, -1 for none.

    A group has room while its extents, at first those of its core, stay within ``reach``. Points with a mean under
    ``square`` are assigned first, by descending confidence. If ``leftovers``, the other points follow, with a mean at
    any distance.

    Args:
        embedding: (N, F) embedding of the points.
        points: (N, 3) points [m].
        core: (N,) group of each point as :func:`seed_groups` found it, -1 for none.
        means: (F, G) mean embeddings, one group a column.
        square: Squared embedding distance under which a point is similar to a mean.
        reach: Largest extent of a group [m]; infinite for no bound.
        directions: (3, K) unit vectors along which the extent of a group is bounded.
        leftovers: Whether points that are similar to no group are assigned too.
    """
    count, width = embedding.shape
    groups, extents = means.shape[1], directions.shape[1]
    masked = reach < np.inf
    low, high = np.full((groups, extents), np.inf), np.full((groups, extents), -np.inf)
    # Extents of the cores.
    for i in range(count):
        if masked and core[i] >= 0:
            _extend(low[core[i]], high[core[i]], points[i], directions, np.inf)
    labels = np.full(count, -1, np.int64)
    distances = np.empty(groups, np.float32)
    for sweep in range(2 if leftovers else 1):
        limit = square if sweep == 0 else np.inf
        for i in range(count):
            if labels[i] >= 0:
                continue
            # Squared distance to every mean, then the nearest group with room.
            distances[:] = 0.0
            for f in range(width):
                value = embedding[i, f]
                for g in range(groups):
                    difference = value - means[f, g]
                    distances[g] += difference * difference
            while True:
                best, nearest = -1, limit
                for g in range(groups):
                    if distances[g] < nearest:
                        best, nearest = g, distances[g]
                if best < 0:
                    break
                if not masked or best == core[i] or _extend(low[best], high[best], points[i], directions, reach):
                    labels[i] = best
                    break
                distances[best] = np.inf
    return labels


@njit(cache=True, nogil=True)
def _root(parent: Ints, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
def _touch(points: Floats, a: int, a_end: int, b: int, b_end: int, square: float) -> bool:
    for i in range(a, a_end):
        for j in range(b, b_end):
            x, y, z = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2]
            if x * x + y * y + z * z <= square:
                return True
    return False


@njit(cache=True, nogil=True)
def linked_cells(points: Floats, keys: Ints, starts: Ints, strides: Ints, radius: float) -> Ints:
    """Return the (C,) component of each grid cell; cells are linked if two of their points are within ``radius``.

    Args:
        points: (N, 3) points [m], sorted by cell. All points of a cell are within the radius of each other.
        keys: (C,) ascending keys ``x * strides[0] + y * strides[1] + z`` of the cells; the strides leave room for two
            cells on each side.
        starts: (C + 1,) first point of each cell.
        strides: (2,) strides of x and y in a key.
        radius: Largest distance between linked points [m].
    """
    cells = len(keys)
    parent = np.arange(cells)
    # Union-find over the cells up to two away; half of the neighbourhood is enough, as links are mutual.
    for c in range(cells):
        for dx in range(3):
            for dy in range(-2 if dx > 0 else 0, 3):
                column = keys[c] + dx * strides[0] + dy * strides[1]
                other = c + 1 if dx == 0 and dy == 0 else np.searchsorted(keys, column - 2)
                while other < cells and keys[other] <= column + 2:
                    a, b = _root(parent, c), _root(parent, other)
                    if a != b and _touch(
                        points, starts[c], starts[c + 1], starts[other], starts[other + 1], radius * radius
                    ):
                        parent[max(a, b)] = min(a, b)
                    other += 1
    for c in range(cells):
        parent[c] = _root(parent, c)
    return parent
