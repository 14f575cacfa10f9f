"""Compiled kernels of the distance from points to triangles: arrays in, arrays out, no threads and no fast maths."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats

Ints = NDArray[np.int64]
_LEAF = 4  # triangles of a leaf at most


@njit(cache=True, nogil=True)
def build_tree(triangles: Floats) -> tuple[Ints, Ints, Floats]:
    """Return a tree of bounding boxes over (F, 3, 3) triangles.

    Returns:
        (F,) triangles sorted by leaf; (N, 3) first and last entry of each node in that order, and its left child or -1
        (the right child follows it); (N, 2, 3) bounds of each node.
    """
    count = len(triangles)
    order = np.arange(count)
    centres = np.empty((count, 3))
    for f in range(count):
        for i in range(3):
            centres[f, i] = (triangles[f, 0, i] + triangles[f, 1, i] + triangles[f, 2, i]) / 3
    nodes, bounds = np.empty((2 * count + 1, 3), np.int64), np.empty((2 * count + 1, 2, 3))
    nodes[0, 0], nodes[0, 1] = 0, count
    used, done = 1, 0
    while done < used:
        first, last = nodes[done, 0], nodes[done, 1]
        spread_low, spread_high = np.full(3, np.inf), np.full(3, -np.inf)
        bounds[done, 0], bounds[done, 1] = np.inf, -np.inf
        for k in range(first, last):
            f = order[k]
            for i in range(3):
                spread_low[i], spread_high[i] = min(spread_low[i], centres[f, i]), max(spread_high[i], centres[f, i])
                for c in range(3):
                    bounds[done, 0, i] = min(bounds[done, 0, i], triangles[f, c, i])
                    bounds[done, 1, i] = max(bounds[done, 1, i], triangles[f, c, i])
        nodes[done, 2] = -1
        if last - first > _LEAF:
            axis = np.argmax(spread_high - spread_low)
            part = order[first:last].copy()
            order[first:last] = part[np.argsort(centres[part, axis])]
            middle = (first + last) // 2
            nodes[done, 2] = used
            nodes[used, 0], nodes[used, 1] = first, middle
            nodes[used + 1, 0], nodes[used + 1, 1] = middle, last
            used += 2
        done += 1
    return order, nodes[:used].copy(), bounds[:used].copy()


@njit(cache=True, nogil=True)
def distances(points: Floats, triangles: Floats, order: Ints, nodes: Ints, bounds: Floats) -> Floats:
    """Return the (N,) exact distances of (N, 3) points to the nearest of the triangles of a tree."""
    out = np.empty(len(points))
    stack = np.empty(128, np.int64)
    for n in range(len(points)):
        p = points[n]
        best = np.inf
        stack[0], top = 0, 1
        while top > 0:
            top -= 1
            node = stack[top]
            if _box_square(p, bounds[node]) >= best:
                continue
            child = nodes[node, 2]
            if child < 0:
                for k in range(nodes[node, 0], nodes[node, 1]):
                    best = min(best, _square(p, triangles[order[k]]))
            else:
                left, right = _box_square(p, bounds[child]), _box_square(p, bounds[child + 1])
                near = child if left <= right else child + 1
                stack[top], stack[top + 1] = 2 * child + 1 - near, near
                top += 2
        out[n] = math.sqrt(best)
    return out


@njit(cache=True, nogil=True)
def _box_square(p: Floats, box: Floats) -> float:
    """Return the squared distance of a point to a box."""
    total = 0.0
    for i in range(3):
        d = max(box[0, i] - p[i], 0.0, p[i] - box[1, i])
        total += d * d
    return total


@njit(cache=True, nogil=True)
def _square(p: Floats, triangle: Floats) -> float:
    """Return the squared distance of a point to a triangle (Ericson, Real-Time Collision Detection, section 5.1.5)."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for i in range(3):
        ab, ac = b[i] - a[i], c[i] - a[i]
        d1 += ab * (p[i] - a[i])
        d2 += ac * (p[i] - a[i])
        d3 += ab * (p[i] - b[i])
        d4 += ac * (p[i] - b[i])
        d5 += ab * (p[i] - c[i])
        d6 += ac * (p[i] - c[i])
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    v, w = 0.0, 0.0  # barycentric coordinates of the closest point: a + v (b - a) + w (c - a)
    if d1 <= 0 and d2 <= 0:
        pass
    elif d3 >= 0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0 and d5 <= d6:
        w = 1.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        v = d1 / (d1 - d3) if d1 > d3 else 0.0
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        w = d2 / (d2 - d6) if d2 > d6 else 0.0
    elif va <= 0 and d4 >= d3 and d5 >= d6:
        along = (d4 - d3) + (d5 - d6)
        w = (d4 - d3) / along if along > 0 else 0.0
        v = 1.0 - w
    else:
        total = va + vb + vc
        v, w = vb / total, vc / total
    square = 0.0
    for i in range(3):
        d = a[i] + v * (b[i] - a[i]) + w * (c[i] - a[i]) - p[i]
        square += d * d
    return square
