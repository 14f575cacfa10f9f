"""Compiled kernels of depth edges: arrays in, arrays out, no threads and no fast maths (same arrays, same bits).

Images are (H, W), indexed [v, u]; depth is 0 where there is no measurement.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats

Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
FEWEST = 4  # measurements on each side that a line is fitted to
WIDEST_GAP = 3  # missing pixels that a grazing surface may account for [px]


@njit(cache=True, nogil=True)
def mean_of_three(depth: Singles, limit: float) -> Singles:
    """Return the (H, W) mean of each depth and those above and below it, where they differ by at most ``limit`` z^2."""
    height, width = depth.shape
    out = depth.copy()
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            if z <= 0.0:
                continue
            total, count, most = z, 1, np.float32(limit) * z * z
            if v > 0 and depth[v - 1, u] > 0.0 and abs(depth[v - 1, u] - z) <= most:
                total += depth[v - 1, u]
                count += 1
            if v + 1 < height and depth[v + 1, u] > 0.0 and abs(depth[v + 1, u] - z) <= most:
                total += depth[v + 1, u]
                count += 1
            out[v, u] = total / count
    return out


@njit(cache=True, nogil=True)
def row_edges(
    depth: Singles,
    focal: float,
    noise: float,
    reach: int,
    jump: float,
    step: float,
    crease: float,
    step_certainty: float,
    crease_certainty: float,
) -> Bools:
    """Return the (H, W) mask of the pixels on the near side of depth steps and on creases, row by row.

    Neighbours whose depths differ by more than the noise and a grazing surface explain form a step; of several in a row
    (flying pixels) the near end is the edge. Elsewhere a line is fitted to the measurements on each side of a pair of
    neighbours, up to the next step. The pair is an edge if the lines miss each other, or meet at an angle, and no pair
    near it is a clearer one.

    Args:
        depth: (H, W) depth [m].
        focal: Focal length along the rows [px].
        noise: Standard deviation of the depth at 1 m, which grows with its square [m].
        reach: Number of measurements on each side that a line is fitted to.
        jump: Slope of a surface that no longer explains the difference of two neighbours, as a tangent.
        step: Smallest distance by which two lines miss each other [m].
        crease: Smallest angle at which they meet [rad].
        step_certainty: Smallest distance in standard deviations.
        crease_certainty: Smallest angle in standard deviations.
    """
    height, width = depth.shape
    out = np.zeros((height, width), np.bool_)
    columns, z = np.empty(width, np.int64), np.empty(width)
    is_step, fits = np.zeros(width, np.bool_), np.empty((width, 4))
    sums, starts, ends = np.zeros((width + 1, 4)), np.empty(width, np.int64), np.empty(width, np.int64)
    strength = np.zeros(width)
    for v in range(height):
        count = _steps(depth[v], focal, noise, jump, columns, z, is_step)
        # Of successive steps in one direction, the near end is the edge.
        k = 0
        while k < count - 1:
            if not is_step[k]:
                k += 1
                continue
            falls, last = z[k + 1] > z[k], k
            while last + 1 < count - 1 and is_step[last + 1] and (z[last + 2] > z[last + 1]) == falls:
                last += 1
            out[v, columns[k] if falls else columns[last + 1]] = True
            k = last + 1
        _line_fits(columns, z, is_step, count, focal, noise, reach, sums, starts, ends, fits)
        for k in range(count - 1):
            apart = min(fits[k, 0] / step, fits[k, 1] / step_certainty)
            bend = min(fits[k, 2] / crease, fits[k, 3] / crease_certainty)
            strength[k] = max(apart, bend)
        for k in range(count - 1):
            if strength[k] < 1.0:
                continue
            clearest = True
            for j in range(max(k - reach // 2, 0), min(k + reach // 2, count - 2) + 1):
                if strength[j] > strength[k] or (strength[j] == strength[k] and j < k):
                    clearest = False
                    break
            if clearest:
                out[v, columns[k] if z[k] <= z[k + 1] else columns[k + 1]] = True
    return out


@njit(cache=True, nogil=True)
def row_deviations(depth: Singles, focal: float, noise: float, reach: int, jump: float) -> Floats:
    """Return the (K, 2) distances and angles of the lines on both sides of all pairs, in standard deviations.

    Where the errors of neighbours are independent, and most surfaces smooth, they are standard normal for most pairs.
    The arguments are those of :func:`row_edges`.
    """
    height, width = depth.shape
    out = np.empty((height * width, 2))
    columns, z = np.empty(width, np.int64), np.empty(width)
    is_step, fits = np.zeros(width, np.bool_), np.empty((width, 4))
    sums, starts, ends = np.zeros((width + 1, 4)), np.empty(width, np.int64), np.empty(width, np.int64)
    found = 0
    for v in range(height):
        count = _steps(depth[v], focal, noise, jump, columns, z, is_step)
        _line_fits(columns, z, is_step, count, focal, noise, reach, sums, starts, ends, fits)
        for k in range(count - 1):
            if fits[k, 1] > 0.0:
                out[found, 0], out[found, 1] = fits[k, 1], fits[k, 3]
                found += 1
    return out[:found]


@njit(cache=True, nogil=True)
def _steps(row: Singles, focal: float, noise: float, jump: float, columns: Ints, z: Floats, is_step: Bools) -> int:
    """Fill in the measurements of a row and which pairs of neighbours form a step; return their number."""
    count = 0
    for u in range(len(row)):
        if row[u] > 0.0:
            columns[count], z[count] = u, row[u]
            count += 1
    for k in range(count - 1):
        nearer = min(z[k], z[k + 1])
        gap = min(columns[k + 1] - columns[k], WIDEST_GAP)
        is_step[k] = abs(z[k + 1] - z[k]) > max(10.0 * noise * nearer * nearer, jump * gap * nearer / focal)
    return count


@njit(cache=True, nogil=True)
def _line_fits(
    columns: Ints,
    z: Floats,
    is_step: Bools,
    count: int,
    focal: float,
    noise: float,
    reach: int,
    sums: Floats,
    starts: Ints,
    ends: Ints,
    fits: Floats,
) -> None:
    """Compare the lines on both sides of each pair of neighbours.

    The columns of ``fits`` are the distance of the lines [m], the same in standard deviations, the angle between them
    [rad], and the same in standard deviations; all are 0 at a step and where too little is measured on a side.
    """
    if count == 0:
        return
    # Running sums of x, z, x^2 and x z, and the first and the last measurement up to a step or a wide gap.
    origin = z[0]
    for k in range(count):
        x, y = float(columns[k]), z[k] - origin
        sums[k + 1, 0] = sums[k, 0] + x
        sums[k + 1, 1] = sums[k, 1] + y
        sums[k + 1, 2] = sums[k, 2] + x * x
        sums[k + 1, 3] = sums[k, 3] + x * y
        joined = k > 0 and not is_step[k - 1] and columns[k] - columns[k - 1] <= reach
        starts[k] = starts[k - 1] if joined else k
    for k in range(count - 1, -1, -1):
        ends[k] = ends[k + 1] if k + 1 < count and starts[k + 1] == starts[k] else k
    for k in range(count - 1):
        fits[k] = 0.0
        if is_step[k]:
            continue
        first, last = max(starts[k], k - reach + 1), min(ends[k + 1], k + reach)
        if k - first + 1 < FEWEST or last - k < FEWEST:
            continue
        middle = 0.5 * (columns[k] + columns[k + 1])
        left, left_variance, left_slope, left_slope_variance = _fitted(sums, first, k, middle)
        right, right_variance, right_slope, right_slope_variance = _fitted(sums, k + 1, last, middle)
        sigma, pitch = noise * z[k] * z[k] + 1e-9, z[k] / focal
        fits[k, 0] = abs(right - left)
        fits[k, 1] = fits[k, 0] / (sigma * np.sqrt(left_variance + right_variance))
        a, b = left_slope / pitch, right_slope / pitch
        # The angle from atan(a) to atan(b); its standard deviation is that of the tangent, divided by 1 + tangent^2.
        fits[k, 2] = abs(np.arctan2(b - a, 1.0 + a * b))
        spread = sigma / pitch * np.sqrt(left_slope_variance + right_slope_variance)
        fits[k, 3] = fits[k, 2] * (1.0 + min(a * a, b * b)) / spread


@njit(cache=True, nogil=True)
def _fitted(sums: Floats, first: int, last: int, middle: float) -> tuple[float, float, float, float]:
    """Return the value at ``middle`` of the line through measurements, and its slope, each with its variance.

    Variances are those of unit noise.
    """
    n = last - first + 1
    x, z = (sums[last + 1, 0] - sums[first, 0]) / n, (sums[last + 1, 1] - sums[first, 1]) / n
    width = sums[last + 1, 2] - sums[first, 2] - n * x * x
    slope = (sums[last + 1, 3] - sums[first, 3] - n * x * z) / width
    return z + slope * (middle - x), 1.0 / n + (middle - x) ** 2 / width, slope, 1.0 / width
