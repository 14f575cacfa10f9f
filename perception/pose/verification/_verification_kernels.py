"""Compiled kernels of verification: arrays in, arrays out, no threads and no fast maths.

Images are (H, W), indexed [v, u]; depth is 0 where there is no measurement. Poses are (4, 4) ``T_cam_part``.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import NEAR, Floats
from perception.pose._transform_kernels import Ints, Singles, apply
from perception.pose.verification._matching_kernels import explained_points, matched_points
from perception.pose.verification._refine_kernels import surface_gaps


@njit(cache=True, nogil=True)
def occluded_points(
    T: Floats, points: Floats, matched: NDArray[np.bool_], depth: Singles, K: Floats, tolerance: float, radius: int
) -> NDArray[np.bool_]:
    """Return (M,) whether an unmatched model point is occluded, or could be because nothing was measured there.

    A point is occluded if it lies more than ``tolerance`` [m] behind everything that was measured in a window of
    ``radius`` pixels. Points that are ``matched`` (M,) are never occluded.
    """
    height, width = depth.shape
    out = np.zeros(len(points), np.bool_)
    for m in range(len(points)):
        if matched[m]:
            continue
        # Nothing is known of a point that is not before the camera or not in the image.
        x, y, z = apply(T, points[m, 0], points[m, 1], points[m, 2])
        out[m] = True
        if z <= NEAR:
            continue
        u, v = K[0, 0] * x / z + K[0, 2] + 0.5, K[1, 1] * y / z + K[1, 2] + 0.5
        if not (0 <= u < width and 0 <= v < height):
            continue
        # Pixels without a measurement have depth 0, so that a window without any occludes the point.
        farthest = 0.0
        for row in range(max(int(v) - radius, 0), min(int(v) + radius, height - 1) + 1):
            for column in range(max(int(u) - radius, 0), min(int(u) + radius, width - 1) + 1):
                farthest = max(farthest, float(depth[row, column]))
        out[m] = farthest < z - tolerance
    return out


@njit(cache=True, nogil=True)
def edge_counts(
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
    depth: Singles,
    K: Floats,
    tolerance: float,
    radius: int,
    group: Floats,
    group_tangents: Floats,
) -> tuple[int, int, int]:
    """Return the numbers of matched and of occluded model points, and that of the group's explained points.

    The arguments are those of :func:`matched_points`, :func:`occluded_points` and :func:`explained_points`.
    """
    matched = matched_points(
        T, points, tangents, boundary, boundary_tangents, starts, shape, origin, cell, gate, depth_gate, min_cosine
    )
    occluded = occluded_points(T, points, matched, depth, K, tolerance, radius)
    explained = explained_points(T, points, tangents, group, group_tangents, gate, depth_gate, min_cosine)
    return int(np.count_nonzero(matched)), int(np.count_nonzero(occluded)), int(np.count_nonzero(explained))


@njit(cache=True, nogil=True)
def gap_counts(
    T: Floats,
    points: Floats,
    normals: Floats,
    visible: NDArray[np.bool_],
    depth: Singles,
    K: Floats,
    radius: int,
    tolerance: float,
) -> tuple[int, int, int, int]:
    """Return the numbers of visible samples, of those with a depth, and of these on and before the measured surface.

    A sample is on it if their distance by :func:`surface_gaps` is at most ``tolerance`` [m].
    """
    gaps = surface_gaps(T, points, normals, visible, depth, K, radius)
    seen, known, on, before = 0, 0, 0, 0
    for m in range(len(gaps)):
        if visible[m]:
            seen += 1
        if np.isnan(gaps[m]):
            continue
        known += 1
        if abs(gaps[m]) <= tolerance:
            on += 1
        elif gaps[m] > tolerance:
            before += 1
    return seen, known, on, before


@njit(cache=True, nogil=True)
def near_points(T: Floats, points: Floats, visible: NDArray[np.bool_], boundary: Floats, gate: float) -> Ints:
    """Return the ascending indices of the boundary points within ``gate`` [m] of a visible posed surface sample."""
    # Visible samples in the camera frame.
    posed = np.empty((len(points), 3))
    count = 0
    for m in range(len(points)):
        if visible[m]:
            posed[count, 0], posed[count, 1], posed[count, 2] = apply(T, points[m, 0], points[m, 1], points[m, 2])
            count += 1
    out = np.empty(len(boundary), np.int64)
    found = 0
    if count == 0:
        return out[:0]
    # Points outside the samples' bounding box are skipped; of the others one near sample is enough.
    low = [posed[:count, k].min() - gate for k in range(3)]
    high = [posed[:count, k].max() + gate for k in range(3)]
    for n in range(len(boundary)):
        x, y, z = boundary[n, 0], boundary[n, 1], boundary[n, 2]
        if x < low[0] or x > high[0] or y < low[1] or y > high[1] or z < low[2] or z > high[2]:
            continue
        for m in range(count):
            if (posed[m, 0] - x) ** 2 + (posed[m, 1] - y) ** 2 + (posed[m, 2] - z) ** 2 <= gate * gate:
                out[found] = n
                found += 1
                break
    return out[:found]
