"""Plain loops for the line fits of depth edges: polynomials of degree one, fitted by NumPy."""

import numpy as np


def row_deviations(depth, focal, noise, reach, jump):
    """Return (K, 2): distance and angle of the lines on both sides of each pair, in standard deviations."""
    found = []
    for row in depth.astype(float):
        u = np.flatnonzero(row > 0)
        z = row[u]
        for k in range(len(u) - 1):
            sides = []
            if _is_step(u, z, k, focal, noise, jump):
                continue
            for first, direction in ((k, -1), (k + 1, 1)):
                side = [first]
                while len(side) < reach:
                    ahead = side[-1] + direction
                    if not 0 <= ahead < len(u) or abs(u[ahead] - u[side[-1]]) > reach:
                        break
                    if _is_step(u, z, min(ahead, side[-1]), focal, noise, jump):
                        break
                    side.append(ahead)
                sides.append(side)
            if min(map(len, sides)) < 4:
                continue
            middle = (u[k] + u[k + 1]) / 2
            fits = []
            for side in sides:
                X = np.column_stack([u[side] - middle, np.ones(len(side))])
                slope, value = np.linalg.lstsq(X, z[side], rcond=None)[0]
                fits.append((value, slope, np.linalg.inv(X.T @ X)))
            sigma, pitch = noise * z[k] ** 2 + 1e-9, z[k] / focal
            (a, left, P), (b, right, Q) = fits
            angle = abs(np.arctan(right / pitch) - np.arctan(left / pitch))
            tangent = min((left / pitch) ** 2, (right / pitch) ** 2)
            found.append(
                (
                    abs(b - a) / (sigma * np.sqrt(P[1, 1] + Q[1, 1])),
                    angle * (1 + tangent) / (sigma / pitch * np.sqrt(P[0, 0] + Q[0, 0])),
                )
            )
    return np.array(found).reshape(-1, 2)


def _is_step(u, z, k, focal, noise, jump):
    nearer, gap = min(z[k], z[k + 1]), min(u[k + 1] - u[k], 3)
    return abs(z[k + 1] - z[k]) > max(10 * noise * nearer**2, jump * gap * nearer / focal)
