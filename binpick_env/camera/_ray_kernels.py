"""Compiled kernels of the ray caster: pixels to groups of rays, and their hits back to pixels.

Arrays in, arrays out; every position is in the camera frame (x right, y down, z forward) [m], and pixel ``(v, u)``
looks along ``((u - cx) / fx, (v - cy) / fy, 1)``, so that a distance along this ray is a depth. ``region`` is the
half-open rectangle ``(u0, v0, u1, v1)`` of pixels that may be touched. No kernel uses fast maths or threads: same
arrays, same bits.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats

Singles = NDArray[np.float32]
Longs = NDArray[np.int64]
Ints = NDArray[np.int32]
Bytes = NDArray[np.uint8]


@njit(cache=True, nogil=True)
def split_groups(group_at: Ints, inside: Bytes, u0: int, v0: int, child: Ints, count: int) -> int:
    """Move the pixels under a mask from their groups to new ones: all pixels of one group to the same new group.

    Args:
        group_at: (H, W) int32 group of each pixel, -1 for none; changed in place.
        inside: (h, w) uint8 mask of the pixels to move.
        u0: Column of the mask's left edge in the image.
        v0: Row of the mask's top edge in the image.
        child: (capacity,) int32 filled with -1; receives the new group of each group that pixels were moved from.
        count: Number of groups so far.

    Returns:
        The new number of groups.
    """
    for v in range(inside.shape[0]):
        for u in range(inside.shape[1]):
            old = group_at[v0 + v, u0 + u]
            if inside[v, u] == 0 or old < 0:
                continue
            if child[old] < 0:
                child[old] = count
                count += 1
            group_at[v0 + v, u0 + u] = child[old]
    return count


@njit(cache=True, nogil=True)
def group_pixels(group_at: Ints, region: Longs, count: int) -> tuple[Longs, Longs]:
    """Sort the region's pixels by group (a counting sort).

    Returns:
        (P,) flat pixel indices, and the (count + 1,) index at which each group starts in them.
    """
    # Count each group's pixels; their running sum is where each group starts.
    start = np.zeros(count + 1, np.int64)
    width = group_at.shape[1]
    for v in range(region[1], region[3]):
        for u in range(region[0], region[2]):
            if group_at[v, u] >= 0:
                start[group_at[v, u] + 1] += 1
    for g in range(count):
        start[g + 1] += start[g]
    # Put each pixel to the next free place of its group.
    place = start[:-1].copy()
    pixels = np.empty(start[-1], np.int64)
    for v in range(region[1], region[3]):
        for u in range(region[0], region[2]):
            g = group_at[v, u]
            if g >= 0:
                pixels[place[g]] = v * width + u
                place[g] += 1
    return pixels, start


@njit(cache=True, nogil=True)
def pixel_rays(pixels: Longs, width: int, K: Floats) -> Floats:
    """Return the (3 N,) float64 rays with z = 1 through flat ``pixels`` (N,)."""
    rays = np.empty(3 * len(pixels))
    for i in range(len(pixels)):
        v = pixels[i] // width
        u = pixels[i] - v * width
        rays[3 * i] = (u - K[0, 2]) / K[0, 0]
        rays[3 * i + 1] = (v - K[1, 2]) / K[1, 1]
        rays[3 * i + 2] = 1.0
    return rays


@njit(cache=True, nogil=True)
def scatter_hits(
    pixels: Longs, hit_geom: Ints, hit_depth: Floats, hit_normal: Floats, depth: Floats, geom_at: Ints, normals: Singles
) -> None:
    """Write rays' results to their pixels in place: flat (H W,) ``depth`` and ``geom_at``, (H W, 3) ``normals``."""
    for i in range(len(pixels)):
        if hit_geom[i] < 0:
            continue
        p = pixels[i]
        depth[p] = hit_depth[i]
        geom_at[p] = hit_geom[i]
        for k in range(3):
            normals[p, k] = hit_normal[3 * i + k]
