"""Compiled kernels of boundary points: arrays in, arrays out, no threads and no fast maths (same arrays, same bits).

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
    """Return the (N, 2) pixel that each edge pixel takes its depth from, or (-1, -1) where no depth is near.

    The window grows while a depth is missing in it, because a sensor loses depth along the outline of a surface. The
    depths within ``step`` of the smallest one belong to the nearest surface. Of these pixels, the one closest in the
    image is taken; ties are decided by the smaller depth, then by reading order.

    Args:
        pixels: (N, 2) edge pixels (u, v).
        depth: (H, W) depth [m], 0 where there is no measurement.
        radius: Half the side of the window [px].
        widest: Half the side up to which the window grows [px].
        step: Largest difference of depths of one surface [m].
    """
    height = len(depth)
    out = np.full((len(pixels), 2), -1, np.int64)
    nearest_in_row, offsets = _row_minima(depth, widest), _sorted_offsets(widest)
    for i in range(len(pixels)):
        u0, v0 = pixels[i]
        r, nearest = radius, _nearest_if_complete(depth, u0, v0, radius)
        if nearest == np.inf:
            # A larger window contains the same gap, so it would grow step by step up to the widest: take that at once.
            r = widest
            for z in nearest_in_row[max(v0 - r, 0) : min(v0 + r, height - 1) + 1, u0]:
                if z < nearest:
                    nearest = z
        if nearest < np.inf:
            out[i] = _closest_pixel(depth, u0, v0, r, nearest + step, offsets)
    return out


@njit(cache=True, nogil=True)
def _nearest_if_complete(depth: Singles, u0: int, v0: int, r: int) -> float:
    """Return the smallest depth of a window, or infinity if any depth is missing."""
    height, width = depth.shape
    nearest = np.inf
    for v in range(max(v0 - r, 0), min(v0 + r, height - 1) + 1):
        for u in range(max(u0 - r, 0), min(u0 + r, width - 1) + 1):
            if depth[v, u] <= 0.0:
                return np.inf
            if depth[v, u] < nearest:
                nearest = depth[v, u]
    return nearest


@njit(cache=True, nogil=True)
def _row_minima(depth: Singles, radius: int) -> Singles:
    """Return the (H, W) smallest depth within ``radius`` pixels along the row, infinity where there is none."""
    height, width = depth.shape
    out = np.empty((height, width), np.float32)
    minima = np.empty(width + 2 * radius, np.float32)
    for v in range(height):
        minima[:] = np.inf
        for u in range(width):
            if depth[v, u] > 0.0:
                minima[radius + u] = depth[v, u]
        # Sliding minimum by doubling: each value is the smallest of the ``reach`` values from its place on.
        reach, side = 1, 2 * radius + 1
        while reach < side:
            shift = min(reach, side - reach)
            here, ahead = minima[: len(minima) - shift], minima[shift:]
            for u in range(len(here)):
                here[u] = ahead[u] if ahead[u] < here[u] else here[u]
            reach += shift
        out[v] = minima[:width]
    return out


@njit(cache=True, nogil=True)
def _sorted_offsets(radius: int) -> Ints:
    """Return the (K, 4) offsets in a window: u, v, the squared length, and the larger of |u| and |v|.

    The offsets are sorted by squared length, those of equal length in reading order.
    """
    side = 2 * radius + 1
    offsets = np.empty((side * side, 4), np.int64)
    for k in range(len(offsets)):
        u, v = k % side - radius, k // side - radius
        offsets[k] = u, v, u * u + v * v, max(abs(u), abs(v))
    return offsets[np.argsort(offsets[:, 2], kind="mergesort")]


@njit(cache=True, nogil=True)
def _closest_pixel(depth: Singles, u0: int, v0: int, r: int, farthest: float, offsets: Ints) -> tuple[int, int]:
    """Return the pixel closest to (u0, v0) in a window whose depth is at most ``farthest``; depth decides a tie."""
    height, width = depth.shape
    inside = r <= u0 < width - r and r <= v0 < height - r
    best_u, best_v, best_depth, last = -1, -1, np.inf, 2 * r * r
    for k in range(len(offsets)):
        if offsets[k, 2] > last:
            break
        u, v = u0 + offsets[k, 0], v0 + offsets[k, 1]
        if offsets[k, 3] > r or not (inside or (0 <= u < width and 0 <= v < height)):
            continue
        z = depth[v, u]
        if 0.0 < z <= farthest and z < best_depth:
            best_u, best_v, best_depth, last = u, v, z, offsets[k, 2]
    return best_u, best_v


@njit(cache=True, nogil=True)
def edge_tangents(
    pixels: Ints, points: Floats, index_at: NDArray[np.int32], K: Floats, radius: int, step: float
) -> tuple[Floats, Floats]:
    """Return the (N, 3) unit tangent of the edge at each boundary point, and its (N,) linearity in [0, 1].

    The tangent in the image is the principal axis of the boundary pixels in a window whose depth is within ``step`` of
    the point's. Its slope in depth is the linear regression of depth along that axis. Linearity is
    ``1 - minor / major`` of the pixels' covariance. A point without neighbours has a zero tangent and linearity 0.

    Args:
        pixels: (N, 2) pixels (u, v) of the boundary points.
        points: (N, 3) boundary points in the camera frame [m].
        index_at: (H, W) index of the boundary point at each pixel, -1 for none.
        K: (3, 3) camera matrix [px].
        radius: Half the side of the window [px].
        step: Largest difference in depth of neighbours on one edge [m].
    """
    height, width = index_at.shape
    tangents = np.zeros((len(pixels), 3))
    linearity = np.zeros(len(pixels))
    for i in range(len(pixels)):
        u0, v0 = pixels[i]
        z0 = points[i, 2]
        # Sum up first and second moments of the neighbours on the same surface.
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
        # Principal axis (a, b) of the neighbours in the image.
        cuu, cuv, cvv = suu - su * su / count, suv - su * sv / count, svv - sv * sv / count
        half, mean = np.sqrt(((cuu - cvv) / 2) ** 2 + cuv * cuv), (cuu + cvv) / 2
        major = mean + half
        if major <= 1e-12:
            continue
        angle = 0.5 * np.arctan2(2 * cuv, cuu - cvv)
        a, b = np.cos(angle), np.sin(angle)
        # Slope of depth along that axis, then the tangent in the camera frame.
        slope = (a * (suz - su * sz / count) + b * (svz - sv * sz / count)) / major  # [m/px]
        # d(point)/ds of point = z(s) ((u - cx) / fx, (v - cy) / fy, 1) along (u, v) = (u0, v0) + s (a, b).
        x = (z0 * a + slope * (u0 - K[0, 2])) / K[0, 0]
        y = (z0 * b + slope * (v0 - K[1, 2])) / K[1, 1]
        length = np.sqrt(x * x + y * y + slope * slope)
        tangents[i, 0], tangents[i, 1], tangents[i, 2] = x / length, y / length, slope / length
        linearity[i] = 1.0 - max(mean - half, 0.0) / major
    return tangents, linearity
