"""Plain loops for the kernels that lay points into cells and look for what stands below points, one at a time."""

import math

import numpy as np


def raise_cells(heights, origin, cell, points, T):
    """Return (X, Y) heights raised to the z of (N, 3) points mapped by a (4, 4) transform."""
    raised = heights.copy()
    for point in points:
        x, y, z = (T[k, 0] * point[0] + T[k, 1] * point[1] + T[k, 2] * point[2] + T[k, 3] for k in range(3))
        i, j = math.floor((x - origin[0]) / cell), math.floor((y - origin[1]) / cell)
        if 0 <= i < raised.shape[0] and 0 <= j < raised.shape[1]:
            raised[i, j] = max(raised[i, j], z)
    return raised


def points_of(depth, K, stride):
    """Return the (N, 3) points of every ``stride``-th pixel that has a depth, camera frame."""
    height, width = depth.shape
    pixels = [(u, v) for v in range(0, height, stride) for u in range(0, width, stride) if depth[v, u] > 0]
    places = []
    for u, v in pixels:
        z = float(depth[v, u])
        places.append((z * (u - K[0, 2]) / K[0, 0], z * ((v - K[1, 2]) / K[1, 1]), z))
    return np.array(places).reshape(-1, 3)


def box_heights(points, places, rotations, sizes):
    """Return the (N,) tops of the highest upright boxes at the points' x and y, -inf beside all."""
    tops = np.full(len(points), -np.inf)
    for n, point in enumerate(points):
        for place, rotation, size in zip(places, rotations, sizes, strict=True):
            along, across, _ = (point - place) @ rotation.reshape(3, 3)
            if abs(along) <= size[0] and abs(across) <= size[1]:
                tops[n] = max(tops[n], place[2] + size[2])
    return tops
