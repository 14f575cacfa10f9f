"""Compiled kernel of chains of edge samples: arrays in, arrays out, no threads and no fast maths."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats
from perception.pose.model._pair_kernels import Ints

Bools = NDArray[np.bool_]


@njit(cache=True, nogil=True)
def facing(normals: Floats, corners: Floats, eye: Floats, least: float) -> Bools:
    """Return (F,) whether the camera is higher than ``least`` over each face's plane.

    Args:
        normals: (F, 3) unit normals.
        corners: (F, 3) a corner of each face [m].
        eye: (4,) homogeneous position of the camera [m].
        least: Height [m].
    """
    out = np.empty(len(normals), dtype=np.bool_)
    for f in range(len(normals)):
        height = 0.0
        for i in range(3):
            height += normals[f, i] * (eye[i] - eye[3] * corners[f, i])
        out[f] = height > least
    return out


@njit(cache=True, nogil=True)
def bounding(front: Bools, faces: Ints, crease: Bools) -> Ints:
    """Return the ascending indices of the edges with one face in front, or two that meet in a crease.

    Args:
        front: (F,) whether each face is turned to the camera.
        faces: (S, 2) faces of each edge.
        crease: (S,) whether each edge is a crease.
    """
    out = np.empty(len(faces), dtype=np.int64)
    count = 0
    for s in range(len(faces)):
        one, other = front[faces[s, 0]], front[faces[s, 1]]
        if one != other or (one and crease[s]):
            out[count] = s
            count += 1
    return out[:count]


@njit(cache=True, nogil=True)
def scatter(points: Floats, pairs: Ints, chain: Ints) -> Floats:
    """Return the (N, 3, 3) covariance of each of (N, 3) points and its neighbours on the same chain.

    Args:
        points: (N, 3) points [m].
        pairs: (P, 2) indices of points near each other, each pair once.
        chain: (N,) chain of each point.
    """
    count = np.ones(len(points))
    total, square = np.zeros((len(points), 3)), np.zeros((len(points), 3, 3))
    for direction in range(2):  # every pair as (point, neighbour) and as (neighbour, point)
        for p in range(len(pairs)):
            n, m = pairs[p, direction], pairs[p, 1 - direction]
            if chain[n] != chain[m]:
                continue
            count[n] += 1.0
            for i in range(3):
                offset = points[m, i] - points[n, i]
                total[n, i] += offset
                for j in range(3):
                    square[n, i, j] += offset * (points[m, j] - points[n, j])
    out = np.empty((len(points), 3, 3))
    for n in range(len(points)):
        for i in range(3):
            for j in range(3):
                out[n, i, j] = square[n, i, j] / count[n] - (total[n, i] / count[n]) * (total[n, j] / count[n])
    return out


@njit(cache=True, nogil=True)
def chains(ends: Ints) -> Ints:
    """Return the (E,) label of the connected chain that each of (E, 2) edges belongs to: one of its vertices.

    Args:
        ends: (E, 2) indices of the vertices of each edge.
    """
    parent = np.arange(ends.max() + 1 if len(ends) else 0)
    for e in range(len(ends)):
        a, b = ends[e, 0], ends[e, 1]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        parent[max(a, b)] = min(a, b)
    out = np.empty(len(ends), dtype=np.int64)
    for e in range(len(ends)):
        a = ends[e, 0]
        while parent[a] != a:
            a = parent[a]
        out[e] = a
    return out


@njit(cache=True, nogil=True)
def cross_products(first: Floats, second: Floats) -> Floats:
    """Return the (N, 3) cross products of (N, 3) vectors, with the bits of ``np.cross``."""
    out = np.empty((len(first), 3))
    for n in range(len(first)):
        out[n, 0] = first[n, 1] * second[n, 2] - first[n, 2] * second[n, 1]
        out[n, 1] = first[n, 2] * second[n, 0] - first[n, 0] * second[n, 2]
        out[n, 2] = first[n, 0] * second[n, 1] - first[n, 1] * second[n, 0]
    return out
