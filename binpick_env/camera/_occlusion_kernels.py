"""Compiled kernels of ambient occlusion: pixels beside a nearer one are found first, then followed along eight lines.

Everything is in the camera frame, in metres. ``depth`` is (H, W) float32, 0 where there is nothing. ``normals`` is
(H, W, 3) float32, unit vectors towards the eye. No kernel uses fast maths or threads: same arrays, same bits.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats

Singles = NDArray[np.float32]
Bytes = NDArray[np.uint8]
Offset = tuple[float, float]
Focal = tuple[float, float, float, float]

DIRECTIONS = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))  # the eight sweeps' (dv, du)
SLACK = 1e-9  # height [m] by which the quick test of a neighbour is lenient: a million times its rounding


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_padded(row: Singles, padded: Floats) -> None:
    """Copy (W,) depths into the middle of (W + 2,) float64; the two ends stay 0: there is nothing beside the image."""
    for u in range(len(row)):
        padded[u + 1] = row[u]


@njit(cache=True, nogil=True, error_model="numpy")
def _may_occlude(near: float, z: float, low: float, facing: float, aside: float, least: float) -> int:
    """Tell whether a neighbour at depth ``near`` is above ``low`` and by more than ``least`` above the tangent plane.

    ``facing`` is the normal times the ray, and ``aside`` the normal times the ray's change to the neighbour.
    """
    return int((near > 0.0) & (near < low) & ((near - z) * facing + near * aside > least))


@njit(cache=True, nogil=True, error_model="numpy")
def _mark_row(
    above: Floats, here: Floats, below: Floats, facing: Floats, across: Floats, down: Floats, floor: float, marks: Bytes
) -> None:
    """Fill a row of (W,) marks: bit k is set if the pixel before this one in direction k may occlude it.

    Args:
        above: (W + 2,) padded depths of the row above [m].
        here: (W + 2,) padded depths of the row [m].
        below: (W + 2,) padded depths of the row below [m].
        facing: (W,) normals times rays.
        across: (W,) change of ``facing`` with one column.
        down: (W,) change of ``facing`` with one row.
        floor: Height above the tangent plane up to which nothing is occluded [m].
        marks: (W,) uint8; overwritten.
    """
    least = floor - SLACK
    for u in range(len(marks)):
        z, f, a, d = here[u + 1], facing[u], across[u], down[u]
        low = z - floor
        mark = _may_occlude(here[u], z, low, f, -a, least)
        mark |= _may_occlude(above[u], z, low, f, -a - d, least) << 1
        mark |= _may_occlude(above[u + 1], z, low, f, -d, least) << 2
        mark |= _may_occlude(above[u + 2], z, low, f, a - d, least) << 3
        mark |= _may_occlude(here[u + 2], z, low, f, a, least) << 4
        mark |= _may_occlude(below[u + 2], z, low, f, a + d, least) << 5
        mark |= _may_occlude(below[u + 1], z, low, f, d, least) << 6
        mark |= _may_occlude(below[u], z, low, f, d - a, least) << 7
        marks[u] = mark


@njit(cache=True, nogil=True, error_model="numpy")
def occluded_sides(depth: Singles, normals: Singles, K: Floats, floor: float) -> Bytes:
    """Return (H W,) uint8 marks: bit k is set if the neighbour before a pixel may occlude it. The end is padded with 0.

    The neighbour is the pixel before this one in direction k of ``DIRECTIONS``. A mark that is not set is certain.
    The length is a multiple of 8.

    Args:
        depth: (H, W) float32 depth [m].
        normals: (H, W, 3) float32 unit normals.
        K: (3, 3) pinhole matrix [px].
        floor: Height above the tangent plane up to which nothing is occluded [m].
    """
    height, width = depth.shape
    marks = np.zeros((height * width + 7) // 8 * 8, np.uint8)
    above, here, below = np.zeros(width + 2), np.zeros(width + 2), np.zeros(width + 2)
    facing, across, down = np.empty(width), np.empty(width), np.empty(width)
    wide, high = 1.0 / K[0, 0], 1.0 / K[1, 1]
    if height:
        _fill_padded(depth[0], here)
    for v in range(height):
        if v + 1 < height:
            _fill_padded(depth[v + 1], below)
        else:
            below[:] = 0.0
        row = normals[v]
        y = v - K[1, 2]
        for u in range(width):
            across[u] = row[u, 0] * wide
            down[u] = row[u, 1] * high
            facing[u] = across[u] * (u - K[0, 2]) + down[u] * y + row[u, 2]
        _mark_row(above, here, below, facing, across, down, floor, marks[v * width : (v + 1) * width])
        above, here, below = here, below, above
    return marks


@njit(cache=True, nogil=True, error_model="numpy")
def _share(above: float, aside: Offset, normal: Offset, focal: Focal, floor: float, full: float) -> float:
    """Return in [0, 1] how much a source occludes a pixel by its height above the pixel's tangent plane.

    Args:
        above: Depth of the source less the pixel's, times the normal's z [m].
        aside: Offset of the source from the pixel along x and y, times the focal lengths [m px].
        normal: The pixel's normal along x and y.
        focal: Focal lengths along x and y [px], and their inverses.
        floor: Height up to which nothing is occluded [m].
        full: Height above ``floor`` from which occlusion is complete [m].
    """
    # Multiplying by the inverse focal length is quick, and exact enough wherever the height is not between the limits.
    height = normal[0] * (aside[0] * focal[2]) + normal[1] * (aside[1] * focal[3]) + above
    if height < floor - SLACK:
        return 0.0
    if height > floor + full + SLACK:
        return 1.0
    height = normal[0] * (aside[0] / focal[0]) + normal[1] * (aside[1] / focal[1]) + above
    return min(max((height - floor) / full, 0.0), 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _follow_lines(
    depth: Singles,
    normals: Singles,
    K: Floats,
    direction: int,
    radius: float,
    floor: float,
    full: float,
    marks: Bytes,
    occluded: Singles,
) -> None:
    """Follow a line from each marked pixel for as long as it is occluded; the direction's marks are cleared.

    Each pixel inherits the occluding pixel of the one before it, and replaces it by that neighbour where it is nearer
    and occludes more. An eighth of the occlusion is added to ``occluded`` in place.
    """
    height, width = depth.shape
    dv, du = DIRECTIONS[direction]
    focal = (K[0, 0], K[1, 1], 1.0 / K[0, 0], 1.0 / K[1, 1])
    cx, cy = K[0, 2], K[1, 2]
    wide = radius * K[0, 0]
    spacing = np.float64(dv * dv + du * du)
    step = np.sqrt(spacing)
    bit, rest = np.uint8(1 << direction), np.uint8(255 - (1 << direction))
    backwards = direction >= 4
    eights = marks.view(np.uint64)
    everywhere = np.uint64(0x0101010101010101) << np.uint64(direction)
    for i in range(len(eights)):
        # Eight pixels at a time: most have no mark. A pixel comes after the one before it in this direction.
        n = len(eights) - 1 - i if backwards else i
        if eights[n] & everywhere == 0:
            continue
        for j in range(8):
            p = 8 * n + (7 - j if backwards else j)
            if marks[p] & bit == 0:
                continue
            v = p // width
            u = p - v * width
            near = near_x = near_y = 0.0  # depth of the source, and its offsets from the image's centre times depth
            count = 0.0  # number of pixels from the source to this one; 0 without a source
            before = np.float64(depth[v - dv, u - du])
            while 0 <= v < height and 0 <= u < width:
                z = np.float64(depth[v, u])
                marked = (marks[v * width + u] & bit) != 0
                if z <= 0.0 or not (marked or count > 0.0):
                    break
                x, y = u - cx, v - cy
                normal = (np.float64(normals[v, u, 0]), np.float64(normals[v, u, 1]))
                ahead = np.float64(normals[v, u, 2])
                reach = wide / z
                best = 0.0
                if count > 0.0:
                    count += 1.0
                    distance = np.sqrt(count * count * spacing)
                    if distance < reach:
                        aside = (near_x - z * x, near_y - z * y)
                        best = _share(ahead * (near - z), aside, normal, focal, floor, full)
                        if best > 0.0:
                            best *= 1.0 - distance / reach
                if marked:
                    marks[v * width + u] &= rest
                    if step < reach:
                        beside_x, beside_y = before * (u - du - cx), before * (v - dv - cy)
                        aside = (beside_x - z * x, beside_y - z * y)
                        other = _share(ahead * (before - z), aside, normal, focal, floor, full) * (1.0 - step / reach)
                        if other > best:
                            best, count = other, 1.0
                            near, near_x, near_y = before, beside_x, beside_y
                if best <= 0.0:
                    break
                occluded[v, u] += 0.125 * best
                before = z
                v += dv
                u += du


@njit(cache=True, nogil=True, error_model="numpy")
def ambient_occlusion(depth: Singles, normals: Singles, K: Floats, radius: float, floor: float, full: float) -> Singles:
    """Return the (H, W) float32 ambient occlusion in [0, 1]: the mean over eight sweeps in different directions.

    Each sweep carries the last depth edge along. Pixels below the edge are occluded, less with distance from it.

    Args:
        depth: (H, W) float32 depth [m].
        normals: (H, W, 3) float32 unit normals.
        K: (3, 3) pinhole matrix [px].
        radius: Distance over which the occlusion by an edge fades to nothing [m].
        floor: Height above the tangent plane up to which nothing is occluded [m]; leaves out facets.
        full: Height above ``floor`` from which occlusion is complete [m].
    """
    occluded = np.zeros(depth.shape, np.float32)
    marks = occluded_sides(depth, normals, K, floor)
    for direction in range(8):
        _follow_lines(depth, normals, K, direction, radius, floor, full, marks, occluded)
    return occluded
