"""Plain loops for the structured-light sensor: every pixel is looked at for shadow, steps and noise."""

import numpy as np


def measure(depth, normals, K, draws, model):
    """Return the measured depth; ``draws`` are the whole image's normal and uniform numbers."""
    height, width = depth.shape
    noise, chance = draws
    x, y = (np.arange(width) - K[0, 2]) / K[0, 0], (np.arange(height) - K[1, 2]) / K[1, 1]
    shadow = projector_shadow(depth, K, model.baseline) if model.baseline else np.zeros(depth.shape, bool)
    measured = np.zeros(depth.shape, np.float32)
    for v in range(height):
        for u in range(width):
            z, n = np.float64(depth[v, u]), normals[v, u].astype(np.float64)
            if z <= 0 or shadow[v, u]:
                continue
            if chance[v, u] < np.float32(model.edge_loss) and beside_step(depth, normals, K, v, u, model.edge_jump):
                continue
            cosine = -(n[0] * x[u] + n[1] * y[v] + n[2]) / np.sqrt(x[u] * x[u] + y[v] * y[v] + 1.0)
            if cosine < np.cos(model.max_incidence):
                continue
            far = z / model.reference
            measured[v, u] = z + np.float64(noise[v, u]) * model.sigma_z * far * far / cosine
    return measured


def projector_shadow(depth, K, baseline):
    """Return the (H, W) mask of pixels that the projector does not reach."""
    shadow = np.zeros(depth.shape, bool)
    sign = 1.0 if baseline > 0 else -1.0
    for v in range(depth.shape[0]):
        reached = np.inf
        for u in range(depth.shape[1])[:: -1 if baseline > 0 else 1]:
            if depth[v, u] > 0:
                column = sign * (u - K[0, 0] * baseline / np.float64(depth[v, u]))
                shadow[v, u] = column >= reached
                reached = min(column, reached)
    return shadow


def beside_step(depth, normals, K, v, u, jump):
    """Tell whether one of a pixel's four neighbours has no depth, or lies off its depth and its tangent plane."""
    for w, s in ((v, u + 1), (v, u - 1), (v + 1, u), (v - 1, u)):
        if not (0 <= w < depth.shape[0] and 0 <= s < depth.shape[1]):
            continue
        z, beside = depth[v, u], depth[w, s]
        if beside <= 0:
            return True
        if np.float64(abs(beside - z)) <= jump:
            continue
        n = normals[v, u].astype(np.float64)
        nx, ny = n[0] / K[0, 0], n[1] / K[1, 1]
        here = nx * (u - K[0, 2]) + ny * (v - K[1, 2]) + n[2]
        there = nx * (s - K[0, 2]) + ny * (w - K[1, 2]) + n[2]
        if there == 0 or abs(np.float64(z) * here / there - np.float64(beside)) > jump:
            return True
    return False
