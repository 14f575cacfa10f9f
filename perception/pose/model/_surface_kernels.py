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
    # Project the samples, and find the extent and the mean depth of those that face the camera.
    posed = np.empty((len(points), 3))  # u, v, z
    cosine = np.full(len(points), -1.0)
    low, high, depth, count = np.full(2, np.inf), np.full(2, -np.inf), 0.0, 0
    for m in range(len(points)):
        x, y, z = apply(T, points[m, 0], points[m, 1], points[m, 2])
        if z <= NEAR:
            continue
        a, b, c = rotate(T, normals[m, 0], normals[m, 1], normals[m, 2])
        posed[m, 0], posed[m, 1], posed[m, 2] = x / z, y / z, z
        cosine[m] = -(a * x + b * y + c * z) / np.sqrt(x * x + y * y + z * z)
        if cosine[m] > 0:
            depth += z
            count += 1
            for i in range(2):
                low[i], high[i] = min(low[i], posed[m, i]), max(high[i], posed[m, i])
    out = np.zeros(len(points), np.bool_)
    if count == 0:
        return out
    # The depth of the nearest sample of each cell.
    cell = max(1.5 * spacing * count / depth, max(high[0] - low[0], high[1] - low[1]) / WIDEST_GRID)
    shape = (int((high[1] - low[1]) / cell) + 1, int((high[0] - low[0]) / cell) + 1)
    nearest = np.full(shape, np.inf)
    for m in range(len(points)):
        if cosine[m] > 0:
            r, c = int((posed[m, 1] - low[1]) / cell), int((posed[m, 0] - low[0]) / cell)
            nearest[r, c] = min(nearest[r, c], posed[m, 2])
    # Compare each sample with it, allowing for the slope of the sample's own surface.
    for m in range(len(points)):
        if cosine[m] >= min_cosine and cosine[m] > 0:
            r, c = int((posed[m, 1] - low[1]) / cell), int((posed[m, 0] - low[0]) / cell)
            slope = np.sqrt(max(1.0 - cosine[m] ** 2, 0.0)) / cosine[m]
            reach = 1.5 * cell * posed[m, 2] * slope + spacing
            out[m] = posed[m, 2] <= nearest[r, c] + reach
    return out
