"""Compiled kernels of the surface model: arrays in, arrays out, no threads and no fast maths."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import NEAR, Floats
from perception.pose._transform_kernels import apply, rotate

WIDEST_GRID = 1024  # cells along a side at most; limits the memory for a pose right before the camera


@njit(cache=True, nogil=True)
def visible_samples(T: Floats, points: Floats, normals: Floats, min_cosine: float, spacing: float) -> NDArray[np.bool_]:
    """Return (M,) whether a surface sample faces the camera and is not self-occluded.

    Samples lie ``spacing`` [m] apart. They are sorted into cells of ``(x / z, y / z)`` that are 1.5 times as wide. A
    sample is occluded if the nearest sample of its cell that faces the camera lies farther in front of it than the
    sample's own surface extends in depth within a cell.
    """
    # Project the samples that face the camera, and find their extent and their mean depth.
    facing, posed, cosine = np.empty(len(points), np.int64), np.empty((len(points), 3)), np.empty(len(points))
    low, high, depth, count = np.full(2, np.inf), np.full(2, -np.inf), 0.0, 0
    for m in range(len(points)):
        x, y, z = apply(T, points[m, 0], points[m, 1], points[m, 2])
        if z <= NEAR:
            continue
        a, b, c = rotate(T, normals[m, 0], normals[m, 1], normals[m, 2])
        away = a * x + b * y + c * z
        if away >= 0:
            continue
        facing[count], cosine[count] = m, -away / np.sqrt(x * x + y * y + z * z)
        posed[count, 0], posed[count, 1], posed[count, 2] = x / z, y / z, z
        for i in range(2):
            low[i], high[i] = min(low[i], posed[count, i]), max(high[i], posed[count, i])
        depth += z
        count += 1
    out = np.zeros(len(points), np.bool_)
    if count == 0:
        return out
    # The depth of the nearest sample of each cell.
    cell = max(1.5 * spacing * count / depth, max(high[0] - low[0], high[1] - low[1]) / WIDEST_GRID)
    rows, columns = int((high[1] - low[1]) / cell) + 1, int((high[0] - low[0]) / cell) + 1
    nearest, cells = np.full(rows * columns, np.inf), np.empty(count, np.int64)
    for k in range(count):
        cells[k] = int((posed[k, 1] - low[1]) / cell) * columns + int((posed[k, 0] - low[0]) / cell)
        nearest[cells[k]] = min(nearest[cells[k]], posed[k, 2])
    # Compare each sample with it, allowing for the slope of the sample's own surface.
    for k in range(count):
        if cosine[k] >= min_cosine and cosine[k] > 0:
            slope = np.sqrt(max(1.0 - cosine[k] ** 2, 0.0)) / cosine[k]
            reach = 1.5 * cell * posed[k, 2] * slope + spacing
            out[facing[k]] = posed[k, 2] <= nearest[cells[k]] + reach
    return out
