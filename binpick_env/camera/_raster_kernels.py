"""Compiled kernels of the rasteriser: triangles to pixels.

Arrays in, arrays out; every position is in the camera frame (x right, y down, z forward) [m], and pixel ``(v, u)``
looks along ``((u - cx) / fx, (v - cy) / fy, 1)``, so that a distance along this ray is a depth. ``region`` is the
half-open rectangle ``(u0, v0, u1, v1)`` of pixels that may be touched. No kernel uses fast maths or threads: same
arrays, same bits.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import NEAR, Floats

Longs = NDArray[np.int64]
Ints = NDArray[np.int32]
Bools = NDArray[np.bool_]
Box = tuple[int, int, int, int]
Span = tuple[int, int]
Lines = tuple[float, float, float, float, float, float, float, float]

NEARLY = 1e-3  # distance of an edge from a pixel's centre up to which the edge planes decide [px]
FAR_OFF = 1e7  # column up to which crossings are found to much less than NEARLY [px]
LONG = 16  # length from which a run of pixels is drawn by vector instructions [px]


@njit(cache=True, nogil=True, error_model="numpy")
def place_vertices(vertices: Floats, vertex_geom: Longs, rotations: Floats, positions: Floats) -> Floats:
    """Map (V, 3) vertices from their geoms' frames by (G, 3, 3) and (G, 3) poses; returns (V, 3)."""
    placed = np.empty_like(vertices)
    for i in range(len(vertices)):
        R = rotations[vertex_geom[i]]
        t = positions[vertex_geom[i]]
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        for k in range(3):
            placed[i, k] = R[k, 0] * x + R[k, 1] * y + R[k, 2] * z + t[k]
    return placed


@njit(cache=True, nogil=True, error_model="numpy")
def _edge_planes(a: Floats, b: Floats, c: Floats, planes: Floats) -> None:
    """Fill (3, 3) with the planes through the eye and each edge; two triangles see a shared edge with exact opposites.

    ``planes[k] @ ray`` is proportional to the barycentric weight of corner k.
    """
    for k in range(3):
        p, q = (b, c) if k == 0 else ((c, a) if k == 1 else (a, b))
        planes[k, 0] = p[1] * q[2] - p[2] * q[1]
        planes[k, 1] = p[2] * q[0] - p[0] * q[2]
        planes[k, 2] = p[0] * q[1] - p[1] * q[0]


@njit(cache=True, nogil=True, error_model="numpy")
def image_plane(vertices: Floats) -> Floats:
    """Return the (V, 2) points ``x / z, y / z`` of (V, 3) vertices; those of vertices behind the eye mean nothing."""
    flat = np.empty((len(vertices), 2))
    for i in range(len(vertices)):
        flat[i, 0] = vertices[i, 0] / vertices[i, 2]
        flat[i, 1] = vertices[i, 1] / vertices[i, 2]
    return flat


@njit(cache=True, nogil=True, error_model="numpy")
def _image_box(low_x: float, low_y: float, high_x: float, high_y: float, K: Floats, region: Longs) -> Box:
    """Return the pixels (u0, v0, u1, v1) of the region that a box of the image plane can cover."""
    u0, v0, u1, v1 = region[0], region[1], region[2], region[3]
    # One pixel more on each side: rounding may not decide here what the edge planes decide exactly.
    low_u = max(np.float64(u0), np.floor(K[0, 0] * low_x + K[0, 2]))
    low_v = max(np.float64(v0), np.floor(K[1, 1] * low_y + K[1, 2]))
    high_u = min(np.float64(u1), np.ceil(K[0, 0] * high_x + K[0, 2]) + 1.0)
    high_v = min(np.float64(v1), np.ceil(K[1, 1] * high_y + K[1, 2]) + 1.0)
    if low_u >= high_u or low_v >= high_v:
        return u0, v0, u0, v0
    return int(low_u), int(low_v), int(high_u), int(high_v)


@njit(cache=True, nogil=True, error_model="numpy")
def _pixel_box(vertices: Floats, flat: Floats, i: int, j: int, k: int, K: Floats, region: Longs) -> Box:
    """Return the rectangle of pixels that the triangle of vertices i, j and k can cover; it is empty behind the eye."""
    u0, v0, u1, v1 = region[0], region[1], region[2], region[3]
    za, zb, zc = vertices[i, 2], vertices[j, 2], vertices[k, 2]
    if za <= NEAR or zb <= NEAR or zc <= NEAR:
        if za <= NEAR and zb <= NEAR and zc <= NEAR:
            return u0, v0, u0, v0
        return u0, v0, u1, v1
    xa, xb, xc = flat[i, 0], flat[j, 0], flat[k, 0]
    ya, yb, yc = flat[i, 1], flat[j, 1], flat[k, 1]
    return _image_box(min(xa, xb, xc), min(ya, yb, yc), max(xa, xb, xc), max(ya, yb, yc), K, region)


@njit(cache=True, nogil=True, error_model="numpy")
def _is_out_of_view(vertices: Floats, flat: Floats, first: int, end: int, K: Floats, region: Longs) -> bool:
    """Tell whether no triangle of the vertices ``first`` to ``end - 1`` can cover a pixel of the region."""
    low_x = low_y = low_z = np.inf
    high_x = high_y = high_z = -np.inf
    for i in range(first, end):
        low_z, high_z = min(low_z, vertices[i, 2]), max(high_z, vertices[i, 2])
        low_x, high_x = min(low_x, flat[i, 0]), max(high_x, flat[i, 0])
        low_y, high_y = min(low_y, flat[i, 1]), max(high_y, flat[i, 1])
    if low_z <= NEAR:
        return high_z <= NEAR
    box = _image_box(low_x, low_y, high_x, high_y, K, region)
    return box[0] >= box[2]


@njit(cache=True, nogil=True, error_model="numpy")
def _row_span(planes: Floats, sign: float, K: Floats, y: float, low: int, high: int) -> Span:
    """Return the half-open columns [low, high) of one row that can be inside; at most a pixel too wide at each end."""
    for k in range(3):
        slope = sign * planes[k, 0] / K[0, 0]
        rest = sign * (planes[k, 1] * y + planes[k, 2]) - slope * K[0, 2]
        if slope > 0.0:
            low = int(min(max(np.floor(-rest / slope), np.float64(low)), np.float64(high)))
        elif slope < 0.0:
            high = int(max(min(np.ceil(-rest / slope) + 1.0, np.float64(high)), np.float64(low)))
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def _is_outside(planes: Floats, sign: float, x: float, y0: float, y1: float, y2: float) -> bool:
    """Tell whether a ray is outside one of three edge planes; ``yk`` is ``planes[k, 1] * y``."""
    return bool(
        sign * (planes[0, 0] * x + y0 + planes[0, 2]) < 0.0
        or sign * (planes[1, 0] * x + y1 + planes[1, 2]) < 0.0
        or sign * (planes[2, 0] * x + y2 + planes[2, 2]) < 0.0
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _edge_lines(planes: Floats, sign: float, K: Floats) -> tuple[bool, Lines]:
    """Return the columns at which a triangle's edges cross a row: ``start + turn * y`` at row coordinate y.

    There are two pairs ``start, turn`` that bound the columns from below, then two from above. The flag is False where
    the triangle has an edge along the rows, whose crossings are not found to within ``NEARLY``.
    """
    low_0 = low_1 = -np.inf
    high_0 = high_1 = np.inf
    low_turn_0 = low_turn_1 = high_turn_0 = high_turn_1 = 0.0
    found = True
    for k in range(3):
        per = -K[0, 0] / planes[k, 0]
        start, turn = K[0, 2] + planes[k, 2] * per, planes[k, 1] * per
        found &= abs(start) < FAR_OFF and abs(turn) < FAR_OFF  # False for an infinite or undefined one, too
        if sign * planes[k, 0] > 0.0:
            found &= low_1 == -np.inf
            low_1, low_turn_1 = low_0, low_turn_0
            low_0, low_turn_0 = start, turn
        else:
            found &= high_1 == np.inf
            high_1, high_turn_1 = high_0, high_turn_0
            high_0, high_turn_0 = start, turn
    return found, (low_0, low_turn_0, low_1, low_turn_1, high_0, high_turn_0, high_1, high_turn_1)


@njit(cache=True, nogil=True, error_model="numpy")
def _bound_rows(lines: Lines, y: Floats, u0: int, u1: int, low: Ints, high: Ints) -> int:
    """Fill the half-open columns of R rows between a triangle's edges; return how many edges nearly meet a centre.

    Args:
        lines: Columns at which the edges cross rows; see `_edge_lines`.
        y: (R,) rows' coordinates at depth 1.
        u0: First column of the triangle's box.
        u1: Column after the last of the triangle's box.
        low: (R,) int32 first columns; overwritten.
        high: (R,) int32 columns after the last; overwritten.
    """
    first, end = np.float64(u0), np.float64(u1)
    near = 0
    for i in range(len(y)):
        left = max(lines[0] + lines[1] * y[i], lines[2] + lines[3] * y[i])
        right = min(lines[4] + lines[5] * y[i], lines[6] + lines[7] * y[i])
        lowest = min(max(np.ceil(left - NEARLY), first), end)
        highest = min(np.floor(right + NEARLY), end - 1.0)
        near += (lowest - left < NEARLY) | (right - highest < NEARLY)
        low[i] = np.int32(lowest)
        high[i] = np.int32(max(highest + 1.0, lowest))
    return near


@njit(cache=True, nogil=True, error_model="numpy")
def _trim(planes: Floats, sign: float, y: float, low: int, high: int, x: Floats) -> Span:
    """Return those of the half-open columns [low, high) of one row that are inside all three edges.

    Along a row each edge plane only grows or only falls, also when rounded: what is inside is one run of pixels.
    """
    y0, y1, y2 = planes[0, 1] * y, planes[1, 1] * y, planes[2, 1] * y
    while low < high and _is_outside(planes, sign, x[low], y0, y1, y2):
        low += 1
    while low < high and _is_outside(planes, sign, x[high - 1], y0, y1, y2):
        high -= 1
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_spans(planes: Floats, sign: float, K: Floats, x: Floats, y: Floats, box: Box, low: Ints, high: Ints) -> None:
    """Fill the half-open columns inside all three edges of a triangle, for each row of its box.

    Args:
        planes: (3, 3) edge planes.
        sign: 1 if the inside is where the planes are positive, -1 if it is where they are negative.
        K: (3, 3) pinhole matrix [px].
        x: (W,) columns' coordinates at depth 1.
        y: (H,) rows' coordinates at depth 1.
        box: Rectangle of pixels ``u0, v0, u1, v1`` that the triangle can cover.
        low: (H,) int32 first columns; overwritten in the box's rows.
        high: (H,) int32 columns after the last; overwritten in the box's rows.
    """
    u0, v0, u1, v1 = box
    found, lines = _edge_lines(planes, sign, K)
    if found and _bound_rows(lines, y[v0:v1], u0, u1, low[v0:v1], high[v0:v1]) == 0:
        return
    # The edge planes decide alone where a crossing is at a pixel's centre, or not known.
    for v in range(v0, v1):
        if not found:
            low[v], high[v] = _row_span(planes, sign, K, y[v], u0, u1)
        low[v], high[v] = _trim(planes, sign, y[v], low[v], high[v], x)


@njit(cache=True, nogil=True, error_model="numpy")
def _draw_run(
    x: Floats,
    n0: float,
    ny: float,
    n2: float,
    offset: float,
    nearest: float,
    farthest: float,
    t: int,
    depth: Floats,
    face_at: Ints,
) -> None:
    """Draw a run of pixels of one row, all inside triangle ``t`` of plane ``(n0, n1, n2)``; ``ny`` is ``n1 * y``."""
    for i in range(len(x)):
        slant = n0 * x[i] + ny + n2
        z = min(max(offset / slant, nearest), farthest)
        nearer = (z < depth[i]) & (slant != 0.0)
        depth[i] = z if nearer else depth[i]
        face_at[i] = t if nearer else face_at[i]


@njit(cache=True, nogil=True, error_model="numpy")
def rasterise(
    vertices: Floats,
    faces: Ints,
    vertex_range: Longs,
    face_range: Longs,
    two_sided: Bools,
    K: Floats,
    x: Floats,
    y: Floats,
    region: Longs,
    depth: Floats,
    face_at: Ints,
) -> None:
    """Draw triangles into a z-buffer: a pixel belongs to a triangle if its centre's ray meets it.

    Args:
        vertices: (V, 3) float64 vertices in the camera frame [m].
        faces: (T, 3) int32 vertices of each face.
        vertex_range: (M, 2) int64 half-open ranges of the vertices that each range of faces uses.
        face_range: (M, 2) int64 half-open ranges of faces to draw.
        two_sided: (T,) mask of the faces that are drawn from both sides; others only from their counter-clockwise side.
        K: (3, 3) pinhole matrix [px].
        x: (W,) float64 coordinates of the image's columns at depth 1.
        y: (H,) float64 coordinates of the image's rows at depth 1.
        region: (4,) int64 rectangle of pixels to draw into.
        depth: (H, W) float64 z-buffer [m], infinite where empty; changed in place.
        face_at: (H, W) int32 face that owns each depth; changed in place.
    """
    planes, lows, highs = np.empty((3, 3)), np.empty(len(y), np.int32), np.empty(len(y), np.int32)
    flat = image_plane(vertices)
    for m in range(len(face_range)):
        if _is_out_of_view(vertices, flat, vertex_range[m, 0], vertex_range[m, 1], K, region):
            continue
        for t in range(face_range[m, 0], face_range[m, 1]):
            i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
            a = vertices[i]
            _edge_planes(a, vertices[j], vertices[k], planes)
            # The sum of the edge planes is the triangle's normal, and the determinant its distance along it.
            offset = a[0] * planes[0, 0] + a[1] * planes[0, 1] + a[2] * planes[0, 2]
            if offset == 0.0 or (offset > 0.0 and not two_sided[t]):
                continue
            u0, v0, u1, v1 = _pixel_box(vertices, flat, i, j, k, K, region)
            if u0 >= u1 or v0 >= v1:
                continue
            n0 = planes[0, 0] + planes[1, 0] + planes[2, 0]
            n1 = planes[0, 1] + planes[1, 1] + planes[2, 1]
            n2 = planes[0, 2] + planes[1, 2] + planes[2, 2]
            sign = 1.0 if offset > 0.0 else -1.0
            _fill_spans(planes, sign, K, x, y, (u0, v0, u1, v1), lows, highs)
            za, zb, zc = a[2], vertices[j, 2], vertices[k, 2]
            nearest, farthest = max(min(za, zb, zc), NEAR), max(za, zb, zc)
            # Row by row: pixels inside all three edges, at the depth of the triangle's plane there.
            for v in range(v0, v1):
                low, high = lows[v], highs[v]
                ny = n1 * y[v]
                if high - low >= LONG:
                    _draw_run(
                        x[low:high], n0, ny, n2, offset, nearest, farthest, t, depth[v, low:high], face_at[v, low:high]
                    )
                    continue
                for u in range(low, high):
                    slant = n0 * x[u] + ny + n2
                    if nearest >= depth[v, u] or slant == 0.0:
                        continue
                    z = min(max(offset / slant, nearest), farthest)
                    if z < depth[v, u]:
                        depth[v, u] = z
                        face_at[v, u] = t


@njit(cache=True, nogil=True, error_model="numpy")
def count_silhouettes(
    vertices: Floats,
    faces: Ints,
    rotations: Floats,
    positions: Floats,
    K: Floats,
    x: Floats,
    y: Floats,
    region: Longs,
    stamp: Ints,
) -> Longs:
    """Return the (N,) number of pixels in the silhouette of one closed mesh at each of N poses, drawn alone.

    Args:
        vertices: (V, 3) float64 vertices in the part frame [m].
        faces: (T, 3) int32 vertices of each face.
        rotations: (N, 3, 3) float64 rotations from the part frame to the camera's.
        positions: (N, 3) float64 origins of the part frame in the camera frame [m].
        K: (3, 3) pinhole matrix [px].
        x: (W,) float64 coordinates of the image's columns at depth 1.
        y: (H,) float64 coordinates of the image's rows at depth 1.
        region: (4,) int64 rectangle of pixels that count.
        stamp: (H, W) int32 last pose that each pixel was counted for, filled with -1; changed in place.
    """
    counts = np.zeros(len(positions), np.int64)
    planes, lows, highs = np.empty((3, 3)), np.empty(len(y), np.int32), np.empty(len(y), np.int32)
    owner = np.zeros(len(vertices), np.int64)
    for n in range(len(positions)):
        placed = place_vertices(vertices, owner, rotations[n : n + 1], positions[n : n + 1])
        flat = image_plane(placed)
        for t in range(len(faces)):
            i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
            a = placed[i]
            _edge_planes(a, placed[j], placed[k], planes)
            offset = a[0] * planes[0, 0] + a[1] * planes[0, 1] + a[2] * planes[0, 2]
            if offset >= 0.0:  # the front faces of a closed mesh cover its whole silhouette
                continue
            u0, v0, u1, v1 = _pixel_box(placed, flat, i, j, k, K, region)
            if u0 >= u1 or v0 >= v1:
                continue
            _fill_spans(planes, -1.0, K, x, y, (u0, v0, u1, v1), lows, highs)
            # Count each pixel once for this pose, whichever of its faces covers it.
            for v in range(v0, v1):
                for u in range(lows[v], highs[v]):
                    counts[n] += stamp[v, u] != n
                    stamp[v, u] = n
    return counts


@njit(cache=True, nogil=True, error_model="numpy")
def faces_to_geoms(face_at: Ints, face_geom: Ints, depth: Floats) -> None:
    """Replace the face of each pixel by its geom, and the depth of pixels that show no face by 0, both in place.

    Args:
        face_at: (H, W) int32 face of each pixel, -1 for none; then the geom.
        face_geom: (T,) int32 geom of each face.
        depth: (H, W) float64 depth [m].
    """
    for v in range(len(face_at)):
        for u in range(face_at.shape[1]):
            t = face_at[v, u]
            if t < 0:
                depth[v, u] = 0.0
            else:
                face_at[v, u] = face_geom[t]
