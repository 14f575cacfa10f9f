"""Plain loops for thinning: every point against every point kept before it."""

import math


def thin_points(points, tangents, radius, angle):
    """Return the indices of the points that stay."""
    kept = {}
    for i, (p, t) in enumerate(zip(points.tolist(), tangents.tolist(), strict=True)):
        length = math.sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])
        if not all(math.isfinite(value) for value in (*p, length)) or length <= 1e-9:
            continue
        t = [value / length for value in t]
        for q, s in kept.values():
            dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            near = dx * dx + dy * dy + dz * dz <= radius * radius
            # Rounding may not tell equal tangents apart at angle 0, nor save square ones at pi / 2.
            if near and abs(t[0] * s[0] + t[1] * s[1] + t[2] * s[2]) >= math.cos(angle) - 1e-12:
                break
        else:
            kept[i] = p, t
    return list(kept)
