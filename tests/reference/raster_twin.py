"""Plain loops for the rasteriser: every pixel is tested against all edges of every triangle."""

import numpy as np

from perception.geometry import NEAR


def rasterise(vertices, faces, two_sided, slopes, region):
    """Return the z-buffer, infinite where it is empty, and the face at each pixel, -1 for none.

    Args:
        vertices: (V, 3) vertices, camera frame.
        faces: (T, 3) vertices of each face.
        two_sided: (T,) faces that are drawn from both sides.
        slopes: Coordinates of the columns (W,) and of the rows (H,) at depth 1.
        region: (4,) rectangle of pixels to draw into.
    """
    x, y = slopes
    depth, face_at = np.full((len(y), len(x)), np.inf), np.full((len(y), len(x)), -1, np.int32)
    u0, v0, u1, v1 = region
    for t, corners in enumerate(vertices[faces]):
        planes = edge_planes(corners)
        offset = corners[0, 0] * planes[0, 0] + corners[0, 1] * planes[0, 1] + corners[0, 2] * planes[0, 2]
        if (corners[:, 2] <= NEAR).all() or offset == 0 or (offset > 0 and not two_sided[t]):
            continue
        normal = planes[0] + planes[1] + planes[2]
        nearest, farthest = max(corners[:, 2].min(), NEAR), corners[:, 2].max()
        for v in range(v0, v1):
            for u in range(u0, u1):
                if (np.sign(offset) * weights(planes, x[u], y[v]) < 0).any():
                    continue
                slant = normal[0] * x[u] + normal[1] * y[v] + normal[2]
                z = min(max(offset / slant, nearest), farthest) if slant else np.inf
                if z < depth[v, u]:
                    depth[v, u], face_at[v, u] = z, t
    return depth, face_at


def edge_planes(corners):
    """Return the (3, 3) planes through the eye and the edge opposite to each of the (3, 3) corners."""
    a, b, c = corners
    pairs = (b, c), (c, a), (a, b)
    return np.array(
        [[p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]] for p, q in pairs]
    )


def weights(planes, x, y):
    """Return the (3,) products of the edge planes and the ray (x, y, 1)."""
    return planes[:, 0] * x + planes[:, 1] * y + planes[:, 2]


def normal_at(corners, corner_normals, R, x, y):
    """Return the (3,) float32 unit normal of a face at the ray (x, y, 1); None where it is not defined."""
    w = weights(edge_planes(corners), x, y)
    n = [0.0, 0.0, 0.0]
    for k in range(3):
        for j in range(3):
            n[j] += w[k] * np.float64(corner_normals[k, j])
    m = [R[j, 0] * n[0] + R[j, 1] * n[1] + R[j, 2] * n[2] for j in range(3)]
    length = -np.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2])
    return np.array(m / length, np.float32) if length < 0 and w[0] + w[1] + w[2] != 0 else None
