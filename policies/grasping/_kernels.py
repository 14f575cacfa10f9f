"""Compiled kernels of the grasp planner. Arrays in, arrays out; every index is checked against its array's bounds.

Gripper tables are passed as ``gaps`` (K,), falling, and ``points`` (K, P, 3), tcp frame, fingertips first. A point at
any gap is interpolated between two rows. Poses are (N, 4, 4); lengths [m].
"""
# mypy: disable-error-code="untyped-decorator, no-any-return"

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

# Number of points that are mapped at once and only then compared with the height map. The first half of the work then
# has no branches and runs on the processor's vector units, eight times as fast.
_CHUNK = 256


@njit(cache=True)
def fill_solid(triangles: Floats, origin: Floats, voxel: float, occupied: Bools) -> None:
    """Mark in (X, Y, Z) ``occupied`` the voxels whose centres lie in a closed mesh of (T, 3, 3) triangles, in place.

    A column along z flips inside and out at every triangle it crosses.
    """
    nx, ny, nz = occupied.shape
    for t in range(triangles.shape[0]):
        # The columns within the bounding box of the triangle's projection along z.
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        i0 = max(int(np.floor((min(a[0], b[0], c[0]) - origin[0]) / voxel)), 0)
        i1 = min(int(np.ceil((max(a[0], b[0], c[0]) - origin[0]) / voxel)), nx - 1)
        j0 = max(int(np.floor((min(a[1], b[1], c[1]) - origin[1]) / voxel)), 0)
        j1 = min(int(np.ceil((max(a[1], b[1], c[1]) - origin[1]) / voxel)), ny - 1)
        # Those that cross the triangle, by barycentric coordinates, are inverted from the crossing upwards.
        for i in range(i0, i1 + 1):
            x = origin[0] + i * voxel
            for j in range(j0, j1 + 1):
                y = origin[1] + j * voxel
                u = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / area
                v = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / area
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                z = u * a[2] + v * b[2] + w * c[2]
                k0 = min(max(int(np.ceil((z - origin[2]) / voxel)), 0), nz)
                for k in range(k0, nz):
                    occupied[i, j, k] = not occupied[i, j, k]


@njit(cache=True)
def _node(gaps: Floats, gap: float) -> tuple[int, float]:
    """Return the row of the table at or above ``gap``, and the weight of the row behind it."""
    last = len(gaps) - 1
    if gap >= gaps[0]:
        return 0, 0.0
    if gap <= gaps[last]:
        return last - 1, 1.0
    low = 0
    while gap < gaps[low + 1]:
        low += 1
    return low, (gaps[low] - gap) / (gaps[low] - gaps[low + 1])


@njit(cache=True)
def _distance(field: Floats, fx: float, fy: float, fz: float) -> float:
    """Interpolate an (X, Y, Z) field trilinearly at fractional indices; all eight neighbours must exist."""
    i, j, k = int(fx), int(fy), int(fz)
    fx, fy, fz = fx - i, fy - j, fz - k
    near = (field[i, j, k] * (1 - fx) + field[i + 1, j, k] * fx) * (1 - fy) + (
        field[i, j + 1, k] * (1 - fx) + field[i + 1, j + 1, k] * fx
    ) * fy
    next_ = (field[i, j, k + 1] * (1 - fx) + field[i + 1, j, k + 1] * fx) * (1 - fy) + (
        field[i, j + 1, k + 1] * (1 - fx) + field[i + 1, j + 1, k + 1] * fx
    ) * fy
    return near * (1 - fz) + next_ * fz


@njit(cache=True)
def clear_of_solid(
    field: Floats,
    origin: Floats,
    voxel: float,
    T_part_tcp: Floats,
    gap: Floats,
    retreat: float,
    gaps: Floats,
    points: Floats,
    is_pad: Bools,
    margin: float,
    pad_margin: float,
) -> Bools:
    """Return for each of N poses, ``retreat`` back along the approach, whether every gripper point keeps its margin.

    ``field`` (X, Y, Z) is a signed distance [m]; all points outside of the field are clear.
    """
    nx, ny, nz = field.shape
    scale = 1.0 / voxel
    clear = np.ones(len(gap), dtype=np.bool_)
    for n in range(len(gap)):
        low, share = _node(gaps, gap[n])
        T = T_part_tcp[n]
        ox, oy, oz = T[0, 3] - origin[0], T[1, 3] - origin[1], T[2, 3] - origin[2]
        for p in range(points.shape[1]):
            # The gripper point in the tcp frame.
            x = points[low, p, 0] + share * (points[low + 1, p, 0] - points[low, p, 0])
            y = points[low, p, 1] + share * (points[low + 1, p, 1] - points[low, p, 1])
            z = points[low, p, 2] + share * (points[low + 1, p, 2] - points[low, p, 2]) - retreat
            # Fractional voxel indices; a point outside of the field is clear.
            fx = (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + ox) * scale
            if not 0.0 <= fx < nx - 1:
                continue
            fy = (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + oy) * scale
            if not 0.0 <= fy < ny - 1:
                continue
            fz = (T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + oz) * scale
            if not 0.0 <= fz < nz - 1:
                continue
            least = pad_margin if is_pad[p] else margin
            # The distance changes by at most the diagonal of a voxel within it, so one corner often decides.
            if field[int(fx), int(fy), int(fz)] - 1.7320509 * voxel > least:
                continue
            if _distance(field, fx, fy, fz) < least:
                clear[n] = False
                break
    return clear


@njit(cache=True)
def _cell_at(x: float, y: float, origin: Floats, cell: float, rows: int, columns: int) -> int:
    """Return the flat index of the cell under a point of a map of ``rows`` by ``columns`` cells, -1 beside it."""
    i, j = np.floor((x - origin[0]) / cell), np.floor((y - origin[1]) / cell)
    return int(i * columns + j) if (i >= 0) & (i < rows) & (j >= 0) & (j < columns) else -1


@njit(cache=True)
def _raise_cells(heights: Floats, cells: Ints, z: Floats, count: int) -> None:
    """Raise (X, Y) ``heights`` to (C,) ``z`` at the first ``count`` of (C,) flat indices, in place; -1 is skipped."""
    flat = heights.reshape(-1)
    for k in range(count):
        if cells[k] >= 0 and z[k] > flat[cells[k]]:
            flat[cells[k]] = z[k]


@njit(cache=True)
def raise_cells(heights: Floats, origin: Floats, cell: float, points: Floats, T_bin_points: Floats) -> None:
    """Raise contiguous (X, Y) ``heights`` to the z of (N, 3) points mapped by a (4, 4) transform, in place."""
    T = T_bin_points
    rows, columns = heights.shape
    cells, heights_of = np.empty(_CHUNK, np.int64), np.empty(_CHUNK)
    for first in range(0, len(points), _CHUNK):
        count = min(_CHUNK, len(points) - first)
        for k in range(count):
            px, py, pz = points[first + k, 0], points[first + k, 1], points[first + k, 2]
            x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
            y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
            heights_of[k] = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
            cells[k] = _cell_at(x, y, origin, cell, rows, columns)
        _raise_cells(heights, cells, heights_of, count)


@njit(cache=True)
def raise_cells_from_depth(
    heights: Floats,
    origin: Floats,
    cell: float,
    depth: NDArray[np.float32],
    K: Floats,
    T_bin_cam: Floats,
    stride: int,
) -> None:
    """Raise contiguous (X, Y) ``heights`` to each ``stride``-th valid pixel of an (H, W) depth image [m], in place."""
    T = T_bin_cam
    rows, columns = heights.shape
    count = (depth.shape[1] + stride - 1) // stride
    cells, heights_of = np.empty(count, np.int64), np.empty(count)
    for v in range(0, depth.shape[0], stride):
        ray_y = (v - K[1, 2]) / K[1, 1]
        for k in range(count):
            pz = float(depth[v, k * stride])
            px, py = pz * (k * stride - K[0, 2]) / K[0, 0], pz * ray_y
            x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
            y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
            heights_of[k] = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
            cells[k] = _cell_at(x, y, origin, cell, rows, columns) if pz > 0.0 else -1
        _raise_cells(heights, cells, heights_of, count)


@njit(cache=True)
def _lowest(
    heights: Floats,
    origin: Floats,
    cell: float,
    outside: float,
    T: Floats,
    gap: float,
    retreat: float,
    gaps: Floats,
    points: Floats,
    labels: Ints,
    stop: float,
    out: Floats,
) -> bool:
    """Lower (3,) ``out`` to the clearances of one pose by label; return False at the first point below ``stop``."""
    low, share = _node(gaps, gap)
    for p in range(points.shape[1]):
        # The gripper point in the tcp frame.
        a, b = points[low, p], points[low + 1, p]
        x = a[0] + share * (b[0] - a[0])
        y = a[1] + share * (b[1] - a[1])
        z = a[2] + share * (b[2] - a[2]) - retreat
        # The height of the scene in the cell under it.
        i = int(np.floor((T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3] - origin[0]) / cell))
        j = int(np.floor((T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3] - origin[1]) / cell))
        ground = heights[i, j] if 0 <= i < heights.shape[0] and 0 <= j < heights.shape[1] else outside
        clearance = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3] - ground
        if clearance < out[labels[p]]:
            out[labels[p]] = clearance
            if clearance < stop:
                return False
    return True


@njit(cache=True)
def scene_clearances(
    heights: Floats,
    origin: Floats,
    cell: float,
    outside: float,
    T_bin_tcp: Floats,
    states: Floats,
    gaps: Floats,
    points: Floats,
    labels: Ints,
) -> Floats:
    """Return the (N, 3) smallest clearances by label over (N, M, 2) ``states``, each a gap and a retreat [m]."""
    out = np.full((len(T_bin_tcp), 3), np.inf)
    for n in range(len(T_bin_tcp)):
        for m in range(states.shape[1]):
            gap, retreat = states[n, m, 0], states[n, m, 1]
            T = T_bin_tcp[n]
            _lowest(heights, origin, cell, outside, T, gap, retreat, gaps, points, labels, -np.inf, out[n])
    return out


@njit(cache=True)
def widest_clear(
    heights: Floats,
    origin: Floats,
    cell: float,
    outside: float,
    T_bin_tcp: Floats,
    widths: Floats,
    extras: Floats,
    allowed: Bools,
    retreats: Floats,
    gaps: Floats,
    points: Floats,
    labels: Ints,
    margin: float,
) -> tuple[Ints, Floats]:
    """Find for each of N grasps the widest clear opening ``width + 2 extras[e]`` with ``allowed[n, e]``.

    Returns:
        (N,) index into the rising ``extras``, -1 where no opening is clear, and the (N,) smallest clearance [m] at that
        opening: over the approach, halfway through closing, and closed.
    """
    choice = np.full(len(widths), -1)
    clearance = np.full(len(widths), -np.inf)
    closed, out = np.empty(3), np.empty(3)
    for n in range(len(widths)):
        # Closed on the part: the same for every opening.
        T, w = T_bin_tcp[n], widths[n]
        closed[:] = np.inf
        if not _lowest(heights, origin, cell, outside, T, w, 0.0, gaps, points, labels, margin, closed):
            continue
        # From the widest opening down: open at contact, half closed, and back along the approach.
        for e in range(len(extras) - 1, -1, -1):
            if not allowed[n, e]:
                continue
            out[:] = closed
            half, full = w + extras[e], w + 2 * extras[e]
            clear = _lowest(heights, origin, cell, outside, T, full, 0.0, gaps, points, labels, margin, out)
            clear = clear and _lowest(heights, origin, cell, outside, T, half, 0.0, gaps, points, labels, margin, out)
            for r in range(len(retreats)):
                back = retreats[r]
                clear = clear and _lowest(
                    heights, origin, cell, outside, T, full, back, gaps, points, labels, margin, out
                )
            if clear:
                choice[n], clearance[n] = e, out.min()
                break
    return choice, clearance
