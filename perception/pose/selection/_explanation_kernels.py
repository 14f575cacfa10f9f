"""Compiled kernels of the explanation of segments: arrays in, arrays out, no threads and no fast maths."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import NEAR, Floats
from perception.pose._transform_kernels import apply, rotate


@njit(cache=True, nogil=True)
def surface_distances(
    T: Floats,
    points: Floats,
    normals: Floats,
    visible: NDArray[np.bool_],
    boundary: Floats,
    starts: NDArray[np.int64],
    shape: tuple[int, int],
    origin: Floats,
    cell: float,
    limit: float,
    sideways: float,
) -> Floats:
    """Return (N,) distance of each boundary point from the visible samples of one pose [m]; infinite beyond ``limit``.

    The distance is the minimum of ``sqrt(off^2 + (sideways * aside)^2)`` over the visible samples. ``off`` is the
    distance from the sample's tangent plane, ``aside`` the distance along it, and ``sideways`` is in (0, 1]. T is
    ``T_cam_part``. The boundary points are sorted by cell, as described at
    :func:`perception.pose.verification._matching_kernels.match_edges`.
    """
    rows, columns = shape
    out = np.full(len(boundary), np.inf)
    reach = limit / sideways
    for m in range(len(points)):
        if not visible[m]:
            continue
        # The sample and its normal in the camera frame.
        x, y, z = apply(T, points[m, 0], points[m, 1], points[m, 2])
        a, b, c = rotate(T, normals[m, 0], normals[m, 1], normals[m, 2])
        if z <= NEAR + reach:
            continue
        # The rectangle of cells that the camera sees a ball of radius reach in.
        u, v = x / z, y / z
        half_u, half_v = reach * (1.0 + abs(u)) / (z - reach), reach * (1.0 + abs(v)) / (z - reach)
        left = max(np.floor((u - half_u - origin[0]) / cell), 0.0)
        right = min(np.floor((u + half_u - origin[0]) / cell), columns - 1.0)
        top = max(np.floor((v - half_v - origin[1]) / cell), 0.0)
        bottom = min(np.floor((v + half_v - origin[1]) / cell), rows - 1.0)
        if left > right or top > bottom:
            continue
        # Lower the squared distances of the points in these cells.
        for row in range(int(top), int(bottom) + 1):
            for k in range(starts[row * columns + int(left)], starts[row * columns + int(right) + 1]):
                dx, dy, dz = boundary[k, 0] - x, boundary[k, 1] - y, boundary[k, 2] - z
                off = a * dx + b * dy + c * dz
                aside = max(dx * dx + dy * dy + dz * dz - off * off, 0.0)
                out[k] = min(out[k], off * off + sideways * sideways * aside)
    # From squares to distances, infinite beyond the limit.
    for k in range(len(out)):
        out[k] = np.sqrt(out[k]) if out[k] <= limit * limit else np.inf
    return out
