"""Compiled kernels of smooth normals: the normals at a face's corners, interpolated at every pixel that shows it.

Arrays in, arrays out; every position is in the camera frame (x right, y down, z forward) [m], and pixel ``(v, u)``
looks along ``(x[u], y[v], 1)``. No kernel uses fast maths or threads: same arrays, same bits.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats

Singles = NDArray[np.float32]
Longs = NDArray[np.int64]
Ints = NDArray[np.int32]
Triple = tuple[float, float, float]
Edges = tuple[Triple, Triple, Triple]

LONG = 16  # length from which a run of pixels is computed by vector instructions [px]


@njit(cache=True, nogil=True, error_model="numpy")
def _edge_plane(p: Floats, q: Floats) -> Triple:
    """Return the plane through the eye and the edge from p to q, computed as the rasteriser's kernels do."""
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


@njit(cache=True, nogil=True, error_model="numpy")
def _columns(rows: Floats | Singles) -> tuple[Triple, Triple, Triple]:
    """Return the columns of a (3, 3) matrix in double precision."""
    return (
        (np.float64(rows[0, 0]), np.float64(rows[1, 0]), np.float64(rows[2, 0])),
        (np.float64(rows[0, 1]), np.float64(rows[1, 1]), np.float64(rows[2, 1])),
        (np.float64(rows[0, 2]), np.float64(rows[1, 2]), np.float64(rows[2, 2])),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _weighed(edges: Edges, x: float, corners: tuple[Triple, Triple, Triple], R: Floats) -> Triple:
    """Return the mean of a face's corner normals at a pixel, turned by ``R``; of any length, 0 if it is not defined.

    The corners are weighted by the barycentric coordinates of the pixel. A face seen from its front has negative
    weights.

    Args:
        edges: For each corner, three terms of the edge plane opposite to it: those of x, of the row and of depth.
        x: Coordinate of the pixel's column at depth 1.
        corners: The corner normals' x, y and z.
        R: (3, 3) axes of the face's geom in the camera frame.
    """
    w0 = edges[0][0] * x + edges[0][1] + edges[0][2]
    w1 = edges[1][0] * x + edges[1][1] + edges[1][2]
    w2 = edges[2][0] * x + edges[2][1] + edges[2][2]
    n0 = 0.0 + w0 * corners[0][0] + w1 * corners[0][1] + w2 * corners[0][2]
    n1 = 0.0 + w0 * corners[1][0] + w1 * corners[1][1] + w2 * corners[1][2]
    n2 = 0.0 + w0 * corners[2][0] + w1 * corners[2][1] + w2 * corners[2][2]
    valid = 1.0 if w0 + w1 + w2 != 0.0 else 0.0
    return (
        valid * (R[0, 0] * n0 + R[0, 1] * n1 + R[0, 2] * n2),
        valid * (R[1, 0] * n0 + R[1, 1] * n1 + R[1, 2] * n2),
        valid * (R[2, 0] * n0 + R[2, 1] * n1 + R[2, 2] * n2),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _weigh_run(
    x: Floats, edges: Edges, corners: tuple[Triple, Triple, Triple], R: Floats, m0: Floats, m1: Floats, m2: Floats
) -> None:
    """Fill a run of pixels of one face with their means of its corners' normals; see `_weighed`."""
    for i in range(len(x)):
        m0[i], m1[i], m2[i] = _weighed(edges, x[i], corners, R)


@njit(cache=True, nogil=True, error_model="numpy")
def _to_unit_length(m0: Floats, m1: Floats, m2: Floats, length: Floats) -> None:
    """Turn a row of vectors round and to unit length in place; ``length`` is filled with their lengths, negated."""
    for u in range(len(length)):
        length[u] = -np.sqrt(m0[u] * m0[u] + m1[u] * m1[u] + m2[u] * m2[u])
        m0[u] /= length[u]
        m1[u] /= length[u]
        m2[u] /= length[u]


@njit(cache=True, nogil=True, error_model="numpy")
def interpolate_normals(
    vertices: Floats,
    faces: Ints,
    corner_normals: Singles,
    face_geom: Ints,
    rotations: Floats,
    x: Floats,
    y: Floats,
    region: Longs,
    face_at: Ints,
    normals: Singles,
) -> None:
    """Overwrite (H, W, 3) float32 ``normals`` in place where ``face_at`` shows a face.

    Args:
        vertices: (V, 3) float64 vertices in the camera frame [m].
        faces: (T, 3) int32 vertices of each face.
        corner_normals: (T, 3, 3) float32 normals at the faces' corners, in their geoms' frames.
        face_geom: (T,) int32 geom of each face.
        rotations: (G, 3, 3) float64 axes of the geoms in the camera frame.
        x: (W,) float64 coordinates of the image's columns at depth 1.
        y: (H,) float64 coordinates of the image's rows at depth 1.
        region: (4,) int64 rectangle of pixels to fill.
        face_at: (H, W) int32 face of each pixel, -1 for none.
        normals: (H, W, 3) float32 unit normals towards the eye; changed in place.
    """
    width = face_at.shape[1]
    m0, m1, m2, length = np.zeros(width), np.zeros(width), np.zeros(width), np.empty(width)
    u0, u1 = region[0], region[2]
    for v in range(region[1], region[3]):
        u = u0
        while u < u1:
            # A run of pixels that show the same face.
            t, first = face_at[v, u], u
            u += 1
            while u < u1 and face_at[v, u] == t:
                u += 1
            if t < 0:
                for w in range(first, u):
                    m0[w] = m1[w] = m2[w] = 0.0
                continue
            a, b, c = vertices[faces[t, 0]], vertices[faces[t, 1]], vertices[faces[t, 2]]
            p, q, r = _edge_plane(b, c), _edge_plane(c, a), _edge_plane(a, b)
            edges = (p[0], p[1] * y[v], p[2]), (q[0], q[1] * y[v], q[2]), (r[0], r[1] * y[v], r[2])
            corners, R = _columns(corner_normals[t]), rotations[face_geom[t]]
            if u - first >= LONG:
                _weigh_run(x[first:u], edges, corners, R, m0[first:u], m1[first:u], m2[first:u])
                continue
            for w in range(first, u):
                m0[w], m1[w], m2[w] = _weighed(edges, x[w], corners, R)
        _to_unit_length(m0[u0:u1], m1[u0:u1], m2[u0:u1], length[u0:u1])
        for u in range(u0, u1):
            if length[u] < 0.0:
                normals[v, u, 0] = m0[u]
                normals[v, u, 1] = m1[u]
                normals[v, u, 2] = m2[u]
