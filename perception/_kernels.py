"""Compiled kernels of perception: arrays in, arrays out, no threads and no fast maths (same arrays, same bits).

Images are (H, W), indexed [v, u]; depth is 0 where there is no measurement; pixels are (N, 2) as (u, v).
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats

Singles = NDArray[np.float32]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True)
def foreground_pixels(pixels: Ints, depth: Singles, radius: int, widest: int, step: float) -> Ints:
    """Return for each pixel the (N, 2) pixel to take its depth from, or (-1, -1) where nothing near has one.

    The window of ``radius`` grows, up to ``widest``, as long as a depth is missing in it: a surface that is lost beside
    its own outline lies behind the hole. Of its pixels within ``step`` of the nearest depth, the one closest in the
    image is taken; the nearer one, then the first in reading order, decides a tie.
    """
    height, width = depth.shape
    out = np.full((len(pixels), 2), -1, np.int64)
    for i in range(len(pixels)):
        u0, v0 = pixels[i]
        for r in range(radius, widest + 1):
            top, bottom, left, right = max(v0 - r, 0), min(v0 + r, height - 1), max(u0 - r, 0), min(u0 + r, width - 1)
            nearest, whole = np.inf, True
            for v in range(top, bottom + 1):
                for u in range(left, right + 1):
                    if depth[v, u] <= 0.0:
                        whole = False
                    elif depth[v, u] < nearest:
                        nearest = depth[v, u]
            if (not whole and r < widest) or nearest == np.inf:
                continue
            best, best_depth = 2 * (widest + 1) ** 2, np.inf
            for v in range(top, bottom + 1):
                for u in range(left, right + 1):
                    z = depth[v, u]
                    if z <= 0.0 or z > nearest + step:
                        continue
                    square = (u - u0) ** 2 + (v - v0) ** 2
                    if square < best or (square == best and z < best_depth):
                        best, best_depth = square, z
                        out[i, 0], out[i, 1] = u, v
            break
    return out


@njit(cache=True, nogil=True)
def edge_tangents(
    pixels: Ints, points: Floats, index_at: NDArray[np.int32], K: Floats, radius: int, step: float
) -> tuple[Floats, Floats]:
    """Return (N, 3) unit tangents of the edge through each boundary point, and (N,) linearity in [0, 1].

    The direction in the image is the main axis of the boundary pixels in a window whose depth is within ``step`` of the
    point's; its slope in depth is their regression along that axis. Linearity is ``1 - minor / major`` of the pixels'
    covariance. A point without neighbours gets a zero tangent and linearity 0.

    Args:
        pixels: (N, 2).
        points: (N, 3) camera frame.
        index_at: (H, W) index of the boundary point at a pixel, -1 for none.
        K: (3, 3).
        radius: Of the window [px].
        step: [m].
    """
    height, width = index_at.shape
    tangents = np.zeros((len(pixels), 3))
    linearity = np.zeros(len(pixels))
    for i in range(len(pixels)):
        u0, v0 = pixels[i]
        z0 = points[i, 2]
        count = 0
        su, sv, sz, suu, suv, svv, suz, svz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for v in range(max(v0 - radius, 0), min(v0 + radius, height - 1) + 1):
            for u in range(max(u0 - radius, 0), min(u0 + radius, width - 1) + 1):
                j = index_at[v, u]
                if j < 0:
                    continue
                dz = points[j, 2] - z0
                if abs(dz) > step:
                    continue
                du, dv = float(u - u0), float(v - v0)
                count += 1
                su += du
                sv += dv
                sz += dz
                suu += du * du
                suv += du * dv
                svv += dv * dv
                suz += du * dz
                svz += dv * dz
        if count < 2:
            continue
        cuu, cuv, cvv = suu - su * su / count, suv - su * sv / count, svv - sv * sv / count
        half, mean = np.sqrt(((cuu - cvv) / 2) ** 2 + cuv * cuv), (cuu + cvv) / 2
        major = mean + half
        if major <= 1e-12:
            continue
        angle = 0.5 * np.arctan2(2 * cuv, cuu - cvv)
        a, b = np.cos(angle), np.sin(angle)
        slope = (a * (suz - su * sz / count) + b * (svz - sv * sz / count)) / major  # [m/px]
        # d(point)/ds of point = z(s) ((u - cx) / fx, (v - cy) / fy, 1) along (u, v) = (u0, v0) + s (a, b).
        x = (z0 * a + slope * (u0 - K[0, 2])) / K[0, 0]
        y = (z0 * b + slope * (v0 - K[1, 2])) / K[1, 1]
        length = np.sqrt(x * x + y * y + slope * slope)
        tangents[i, 0], tangents[i, 1], tangents[i, 2] = x / length, y / length, slope / length
        linearity[i] = 1.0 - max(mean - half, 0.0) / major
    return tangents, linearity


@njit(cache=True, nogil=True)
def nearest_surface(depth: Singles, u0: int, v0: int, cell: float, shape: tuple[int, int], step: float) -> Singles:
    """Return (h, w) mean depth of the nearest surface in each square of ``cell`` pixels from (u0, v0), 0 for none.

    A pixel belongs to the square that its middle is in. Of a square's depths those within ``step`` of the smallest are
    averaged, so that no value lies between two surfaces.
    """
    height, width = depth.shape
    rows, columns = shape
    nearest = np.full((rows, columns), np.inf, np.float32)
    total = np.zeros((rows, columns), np.float64)
    count = np.zeros((rows, columns), np.int64)
    v1, u1 = min(int(v0 + np.ceil(rows * cell)), height), min(int(u0 + np.ceil(columns * cell)), width)
    for v in range(max(v0, 0), v1):
        r = int((v - v0 + 0.5) / cell)
        if r >= rows:
            continue
        for u in range(max(u0, 0), u1):
            c = int((u - u0 + 0.5) / cell)
            z = depth[v, u]
            if z > 0 and c < columns and z < nearest[r, c]:
                nearest[r, c] = z
    for v in range(max(v0, 0), v1):
        r = int((v - v0 + 0.5) / cell)
        if r >= rows:
            continue
        for u in range(max(u0, 0), u1):
            c = int((u - u0 + 0.5) / cell)
            z = depth[v, u]
            if z > 0 and c < columns and z <= nearest[r, c] + step:
                total[r, c] += z
                count[r, c] += 1
    out = np.zeros((rows, columns), np.float32)
    for r in range(rows):
        for c in range(columns):
            if count[r, c] > 0:
                out[r, c] = total[r, c] / count[r, c]
    return out
