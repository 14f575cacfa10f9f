"""Plain loops for the clearance kernel: every pose, every point, one at a time."""

import math

import numpy as np


def clearances(heights, origin, cell, outside, T_bin_tcp, moments, points_of_gap, labels):
    """Return (N, 3) smallest heights above the map; ``moments[n]`` lists (gap, retreat)."""
    lowest = np.full((len(T_bin_tcp), 3), np.inf)
    for n, T in enumerate(T_bin_tcp):
        for gap, retreat in moments[n]:
            for point, label in zip(points_of_gap(gap), labels, strict=True):
                x, y, z, _ = T @ (point[0], point[1], point[2] - retreat, 1.0)
                i, j = math.floor((x - origin[0]) / cell), math.floor((y - origin[1]) / cell)
                known = 0 <= i < heights.shape[0] and 0 <= j < heights.shape[1]
                ground = heights[i, j] if known else outside
                lowest[n, label] = min(lowest[n, label], z - ground)
    return lowest
