"""Plain loops for the kernels of boundary points: every pixel, every neighbour, one at a time, in NumPy's doubles."""

import numpy as np


def foreground_pixels(pixels, depth, radius, widest, step):
    """Return (N, 2): the pixel of the nearest surface, by sorting all candidates of the first whole window."""
    height, width = depth.shape
    chosen = []
    for u0, v0 in pixels:
        best = (-1, -1)
        for r in range(radius, widest + 1):
            window = [
                (float(depth[v, u]), v, u)
                for v in range(v0 - r, v0 + r + 1)
                for u in range(u0 - r, u0 + r + 1)
                if 0 <= v < height and 0 <= u < width
            ]
            seen = [p for p in window if p[0] > 0]
            if seen and (len(seen) == len(window) or r == widest):
                front = [p for p in seen if p[0] <= min(seen)[0] + step]
                _, v, u = min(front, key=lambda p: ((p[2] - u0) ** 2 + (p[1] - v0) ** 2, p[0], p[1], p[2]))
                best = (u, v)
                break
        chosen.append(best)
    return np.array(chosen, np.int64).reshape(-1, 2)


def edge_tangents(pixels, points, K, radius, step):
    """Return (N, 3) tangents up to sign and (N,) linearity: eigenvectors of the covariance, a line fitted to depth."""
    tangents, linearity = np.zeros((len(pixels), 3)), np.zeros(len(pixels))
    for i in range(len(pixels)):
        near = [
            j
            for j in range(len(pixels))
            if np.abs(pixels[j] - pixels[i]).max() <= radius and abs(points[j, 2] - points[i, 2]) <= step
        ]
        if len(near) < 2:
            continue
        offsets = (pixels[near] - pixels[near].mean(axis=0)).astype(float)
        values, vectors = np.linalg.eigh(offsets.T @ offsets)
        axis = vectors[:, 1]
        along = offsets @ axis
        slope = along @ points[near, 2] / (along @ along)
        # One pixel further along the edge, by small differences of the pinhole equation.
        ends = []
        for s in (-1e-4, 1e-4):
            z = points[i, 2] + s * slope
            ends.append(z * np.linalg.solve(K, [*(pixels[i] + s * axis), 1.0]))
        tangents[i] = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        linearity[i] = 1.0 - values[0] / values[1]
    return tangents, linearity


def nearest_surface(depth, u0, v0, cell, shape, step):
    """Return (h, w): for each cell, collect its pixels' depths and average those close to the smallest."""
    out = np.zeros(shape)
    for r in range(shape[0]):
        for c in range(shape[1]):
            inside = [
                float(depth[v, u])
                for v in range(max(v0, 0), depth.shape[0])
                for u in range(max(u0, 0), depth.shape[1])
                if r <= (v - v0 + 0.5) / cell < r + 1 and c <= (u - u0 + 0.5) / cell < c + 1 and depth[v, u] > 0
            ]
            front = [z for z in inside if z <= min(inside) + step]
            out[r, c] = np.mean(front) if front else 0.0
    return out
