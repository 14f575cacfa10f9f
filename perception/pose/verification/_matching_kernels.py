"""Compiled kernels that match a posed model's edge points with boundary points: arrays in, arrays out, no threads.

Poses are (4, 4) ``T_cam_part``. M model points are in the part frame and N boundary points in the camera frame, sorted
by square cells of ``(x / z, y / z)``: those of cell (r, c) begin at ``starts[r * columns + c]`` and end where the next
cell begins.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import NEAR, Floats
from perception.pose._transform_kernels import Ints, apply, rotate

_WIDER = 1.0 + 1e-9  # the cells within a distance are sought within a larger one, for rounding


@njit(cache=True, nogil=True)
def gated_square(
    dx: float, dy: float, dz: float, x: float, y: float, z: float, gate: float, depth_gate: float
) -> float:
    """Return the squared length of an offset whose part along the line of sight to (x, y, z) is reduced."""
    square = dx**2 + dy**2 + dz**2
    if depth_gate > gate:
        along = dx * x + dy * y + dz * z
        square -= along * along / (x * x + y * y + z * z) * (1.0 - (gate / depth_gate) ** 2)
    return square


@njit(cache=True, nogil=True)
def _cells(
    x: float, y: float, z: float, reach: float, depth_reach: float, shape: tuple[int, int], origin: Floats, cell: float
) -> tuple[int, int, int, int]:
    """Return the first and the last row and column of cells that the camera sees an ellipsoid with these semi-axes in.

    There is none if the last is before the first. ``z`` must be larger than ``depth_reach``.
    """
    rows, columns = shape
    u, v = x / z, y / z
    half_u, half_v = reach * (1.0 + abs(u)) / (z - depth_reach), reach * (1.0 + abs(v)) / (z - depth_reach)
    left = max(np.floor((u - half_u - origin[0]) / cell), 0.0)
    right = min(np.floor((u + half_u - origin[0]) / cell), columns - 1.0)
    top = max(np.floor((v - half_v - origin[1]) / cell), 0.0)
    bottom = min(np.floor((v + half_v - origin[1]) / cell), rows - 1.0)
    if left > right or top > bottom:
        return 0, -1, 0, -1
    return int(top), int(bottom), int(left), int(right)


@njit(cache=True, nogil=True)
def rematch_edges(
    matches: Ints,
    T: Floats,
    points: Floats,
    tangents: Floats,
    boundary: Floats,
    boundary_tangents: Floats,
    starts: NDArray[np.int64],
    shape: tuple[int, int],
    origin: Floats,
    cell: float,
    gate: float,
    depth_gate: float,
    min_cosine: float,
) -> None:
    """Write to ``matches`` what :func:`match_edges` returns; the less they change, the faster it is.

    ``matches`` holds the (M,) matches in a pose near this one, or -1. The nearest boundary point is not farther away
    than the last match, so that fewer cells are searched.
    """
    for m in range(len(points)):
        # The model point and its tangent in the camera frame.
        x, y, z = apply(T, points[m, 0], points[m, 1], points[m, 2])
        a, b, c = rotate(T, tangents[m, 0], tangents[m, 1], tangents[m, 2])
        before, matches[m] = matches[m], -1
        if z <= NEAR + depth_gate:
            continue
        # The last match sets the distance within which to search, if it still is a match.
        nearest, share = gate * gate, 1.0
        if before >= 0:
            k = before
            square = gated_square(boundary[k, 0] - x, boundary[k, 1] - y, boundary[k, 2] - z, x, y, z, gate, depth_gate)
            along = a * boundary_tangents[k, 0] + b * boundary_tangents[k, 1] + c * boundary_tangents[k, 2]
            if square < nearest and abs(along) >= min_cosine:
                nearest, share = square, min(math.sqrt(square) / gate * _WIDER, 1.0)
        # The nearest point of like tangent in these cells; those of one row lie one after the other.
        top, bottom, left, right = _cells(x, y, z, gate * share, depth_gate * share, shape, origin, cell)
        for row in range(top, bottom + 1):
            for k in range(starts[row * shape[1] + left], starts[row * shape[1] + right + 1]):
                square = gated_square(
                    boundary[k, 0] - x, boundary[k, 1] - y, boundary[k, 2] - z, x, y, z, gate, depth_gate
                )
                if square > nearest or (square == nearest and matches[m] >= 0):
                    continue
                along = a * boundary_tangents[k, 0] + b * boundary_tangents[k, 1] + c * boundary_tangents[k, 2]
                if abs(along) >= min_cosine:
                    nearest = square
                    matches[m] = k


@njit(cache=True, nogil=True)
def match_edges(
    T: Floats,
    points: Floats,
    tangents: Floats,
    boundary: Floats,
    boundary_tangents: Floats,
    starts: NDArray[np.int64],
    shape: tuple[int, int],
    origin: Floats,
    cell: float,
    gate: float,
    depth_gate: float,
    min_cosine: float,
) -> Ints:
    """Return (M,) index of the nearest boundary point of like tangent within ``gate`` [m] of each model point, or -1.

    Along the line of sight it may be off by ``depth_gate`` [m], at least ``gate``: distances along it count in the
    ratio of the two. Of equally near points the first one is the match.
    """
    matches = np.full(len(points), -1, np.int64)
    rematch_edges(
        matches,
        T,
        points,
        tangents,
        boundary,
        boundary_tangents,
        starts,
        shape,
        origin,
        cell,
        gate,
        depth_gate,
        min_cosine,
    )
    return matches


@njit(cache=True, nogil=True)
def matched_points(
    T: Floats,
    points: Floats,
    tangents: Floats,
    boundary: Floats,
    boundary_tangents: Floats,
    starts: NDArray[np.int64],
    shape: tuple[int, int],
    origin: Floats,
    cell: float,
    gate: float,
    depth_gate: float,
    min_cosine: float,
) -> NDArray[np.bool_]:
    """Return (M,) whether :func:`match_edges` finds a match; the first one that is found is enough."""
    matched = np.zeros(len(points), np.bool_)
    for m in range(len(points)):
        x, y, z = apply(T, points[m, 0], points[m, 1], points[m, 2])
        a, b, c = rotate(T, tangents[m, 0], tangents[m, 1], tangents[m, 2])
        if z <= NEAR + depth_gate:
            continue
        top, bottom, left, right = _cells(x, y, z, gate, depth_gate, shape, origin, cell)
        for row in range(top, bottom + 1):
            for k in range(starts[row * shape[1] + left], starts[row * shape[1] + right + 1]):
                square = gated_square(
                    boundary[k, 0] - x, boundary[k, 1] - y, boundary[k, 2] - z, x, y, z, gate, depth_gate
                )
                along = a * boundary_tangents[k, 0] + b * boundary_tangents[k, 1] + c * boundary_tangents[k, 2]
                if square <= gate * gate and abs(along) >= min_cosine:
                    matched[m] = True
                    break
            if matched[m]:
                break
    return matched


@njit(cache=True, nogil=True)
def explained_points(
    T: Floats,
    points: Floats,
    tangents: Floats,
    boundary: Floats,
    boundary_tangents: Floats,
    gate: float,
    depth_gate: float,
    min_cosine: float,
) -> NDArray[np.bool_]:
    """Return (N,) whether each boundary point, in any order, has a posed model point of like tangent near it.

    Near is within ``gate`` [m], along the line of sight within ``depth_gate`` [m], at least ``gate``.
    """
    # Model points and tangents in the camera frame, those before the camera sorted by x / z.
    posed, seen = np.empty((len(points), 6)), np.empty(len(points))
    for m in range(len(points)):
        posed[m, 0], posed[m, 1], posed[m, 2] = apply(T, points[m, 0], points[m, 1], points[m, 2])
        posed[m, 3], posed[m, 4], posed[m, 5] = rotate(T, tangents[m, 0], tangents[m, 1], tangents[m, 2])
        seen[m] = posed[m, 0] / posed[m, 2] if posed[m, 2] > 0 else np.inf
    order = np.argsort(seen)
    posed, seen = posed[order], seen[order]
    # Of the model points whose x / z is that of points near enough, the first near one of like tangent is enough.
    out = np.zeros(len(boundary), np.bool_)
    for n in range(len(boundary)):
        x, y, z = boundary[n, 0], boundary[n, 1], boundary[n, 2]
        a, b, c = boundary_tangents[n, 0], boundary_tangents[n, 1], boundary_tangents[n, 2]
        first, last = 0, len(posed)
        if z > NEAR + depth_gate:
            u = x / z
            half = depth_gate * (1.0 + abs(u)) / (z - depth_gate) * _WIDER
            first, last = np.searchsorted(seen, u - half), np.searchsorted(seen, u + half, side="right")
        for m in range(first, last):
            square = gated_square(posed[m, 0] - x, posed[m, 1] - y, posed[m, 2] - z, x, y, z, gate, depth_gate)
            if square <= gate * gate and abs(posed[m, 3] * a + posed[m, 4] * b + posed[m, 5] * c) >= min_cosine:
                out[n] = True
                break
    return out
