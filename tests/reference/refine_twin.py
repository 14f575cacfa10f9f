"""Plain loops for the kernels of refinement and verification: all model points, boundary points and pixels."""

import math

import numpy as np
from scipy.spatial.transform import Rotation


def posed(T, points, normals):
    return points @ T[:3, :3].T + T[:3, 3], normals @ T[:3, :3].T


def gated_distance(offset, sight, gate, depth_gate):
    """Return the length of an offset whose part along a line of sight counts in the ratio of the two gates."""
    ray = sight / np.linalg.norm(sight)
    along = (offset @ ray) * ray
    return np.linalg.norm(offset - along + along * gate / depth_gate)


def match_edges(T, points, tangents, boundary, boundary_tangents, gate, min_cosine, depth_gate=None):
    """Return (M,) the nearest of all boundary points of like tangent, or -1."""
    matches = []
    for p, t in zip(*posed(T, points, tangents), strict=True):
        like = [
            (gated_distance(boundary[k] - p, p, gate, depth_gate or gate), k)
            for k in range(len(boundary))
            if abs(t @ boundary_tangents[k]) >= min_cosine
        ]
        near = [found for found in like if found[0] <= gate]
        matches.append(min(near)[1] if near else -1)
    return np.array(matches)


def step_of(centre, arm, p):
    """Return (3, 6): how a posed point moves with each of the six lengths of a motion."""
    return np.array([np.cross(axis, p - centre) / arm for axis in np.eye(3)] + list(np.eye(3))).T


def line_equations(T, points, matches, boundary, boundary_tangents, centre, arm):
    """Return J'J, J'e, e'e of the distances to the lines, stacked."""
    rows, errors = [np.zeros((0, 6))], [np.zeros(0)]
    for p, k in zip(posed(T, points, points)[0], matches, strict=True):
        if k < 0:
            continue
        across = np.eye(3) - np.outer(boundary_tangents[k], boundary_tangents[k])
        rows.append(across @ step_of(centre, arm, p))
        errors.append(across @ (p - boundary[k]))
    J, e = np.concatenate(rows), np.concatenate(errors)
    return J.T @ J, J.T @ e, e @ e, len(e) // 3


def visible_samples(T, points, normals, min_cosine, spacing):
    """Return (M,) whether a sample faces the camera and none of the same cell lies clearly before it."""
    points_cam, normals_cam = posed(T, points, normals)
    both = zip(points_cam, normals_cam, strict=True)
    cosine = [-(n @ p) / np.linalg.norm(p) if p[2] > 1e-3 else -1.0 for p, n in both]
    facing = [m for m in range(len(points)) if cosine[m] > 0]
    visible = np.zeros(len(points), bool)
    if not facing:
        return visible
    seen = points_cam[:, :2] / points_cam[:, 2:]
    low, high = seen[facing].min(axis=0), seen[facing].max(axis=0)
    cell = max(1.5 * spacing / points_cam[facing, 2].mean(), (high - low).max() / 1024)
    cells = np.floor((seen - low) / cell)
    for m in facing:
        front = min(points_cam[k, 2] for k in facing if (cells[k] == cells[m]).all())
        slope = math.tan(math.acos(min(cosine[m], 1.0)))
        reach = 1.5 * cell * points_cam[m, 2] * slope + spacing
        visible[m] = cosine[m] >= min_cosine and points_cam[m, 2] <= front + reach
    return visible


def measured_point(depth, K, u, v):
    height, width = depth.shape
    if not (0 <= u < width and 0 <= v < height) or depth[v, u] <= 0:
        return None
    return float(depth[v, u]) * np.linalg.solve(K, [u, v, 1.0])


def pixel_of(K, p):
    u, v, _ = K @ p / p[2]
    return math.floor(u + 0.5), math.floor(v + 0.5)


def surface_gaps(T, points, normals, visible, depth, K, radius):
    """Return (M,) the least signed distance from the measured points around a sample's pixel to its plane."""
    gaps = np.full(len(points), np.nan)
    height, width = depth.shape
    for m, (p, n) in enumerate(zip(*posed(T, points, normals), strict=True)):
        if not visible[m] or p[2] <= 1e-3:
            continue
        u0, v0 = pixel_of(K, p)
        if not (0 <= u0 < width and 0 <= v0 < height):
            continue
        around = [
            measured_point(depth, K, u, v)
            for v in range(v0 - radius, v0 + radius + 1)
            for u in range(u0 - radius, u0 + radius + 1)
        ]
        found = [n @ (p - q) for q in around if q is not None]
        if found:
            gaps[m] = min(found, key=abs)
    return gaps


def measured_normal(depth, K, u, v, reach):
    """Return the (3,) normal at a pixel by central differences, or None."""
    ends = [measured_point(depth, K, u + i * reach, v + j * reach) for i, j in ((-1, 0), (1, 0), (0, -1), (0, 1))]
    if any(end is None for end in ends):
        return None
    west, east, north, south = ends
    normal = np.cross(south - north, east - west)
    return normal / np.linalg.norm(normal)


def plane_equations(T, points, normals, visible, depth, K, gate, min_cosine, reach, centre, arm):
    """Return J'WJ, J'We, e'e and the count of the distances along the samples' normals, Tukey's weights in W."""
    hessian, gradient, total, count = np.zeros((6, 6)), np.zeros(6), 0.0, 0
    for m, (p, n) in enumerate(zip(*posed(T, points, normals), strict=True)):
        q = measured_point(depth, K, *pixel_of(K, p)) if visible[m] else None
        if q is None or abs(n @ (p - q)) >= gate:
            continue
        measured = measured_normal(depth, K, *pixel_of(K, p), reach)
        if measured is None or n @ measured < min_cosine:
            continue
        row, error = n @ step_of(centre, arm, p), n @ (p - q)
        weight = (1 - (error / gate) ** 2) ** 2
        hessian += weight * np.outer(row, row)
        gradient += weight * row * error
        total, count = total + error**2, count + 1
    return hessian, gradient, total, count


def gauss_newton_step(hessian, gradient, damping, observable):
    """Return the (6,) damped step, without the eigenvectors whose eigenvalues are no larger than ``observable``."""
    values, vectors = np.linalg.eigh(hessian)
    told = values > max(observable, 1e-12)
    return -vectors[:, told] @ ((vectors[:, told].T @ gradient) / (values[told] + damping))


def moved(T, motion, pivot, arm):
    """Return a pose turned about a point by a rotation vector, then shifted."""
    turn = Rotation.from_rotvec(motion[:3] / arm).as_matrix()
    out = np.eye(4)
    out[:3, :3] = turn @ T[:3, :3]
    out[:3, 3] = turn @ (T[:3, 3] - pivot) + pivot + motion[3:]
    return out


def descended(T, equations, centre, arm, iterations, damping, observable, still):
    """Return the pose after Gauss-Newton steps, their number, the last one's length in d_max, and the last equations.

    ``equations(T, pivot)`` gives J'J, J'e, e'e and the count.
    """
    length, steps = math.inf, 0
    while True:
        pivot = T[:3, :3] @ centre + T[:3, 3]
        H, g, total, count = equations(T, pivot)
        if length < still or steps == iterations or count < 6:
            return T, steps, length, total, count
        motion = gauss_newton_step(H / count, g / count, damping, observable)
        T, steps, length = moved(T, motion, pivot, arm), steps + 1, np.linalg.norm(motion) / (2 * arm)


def occluded_points(T, points, matches, depth, K, tolerance, radius):
    """Return (M,) whether an unmatched point lies well behind all that was measured around it, or nothing was."""
    occluded = []
    height, width = depth.shape
    for p, k in zip(posed(T, points, points)[0], matches, strict=True):
        if k >= 0 or p[2] <= 1e-3:
            occluded.append(k < 0)
            continue
        u0, v0 = pixel_of(K, p)
        window = range(v0 - radius, v0 + radius + 1), range(u0 - radius, u0 + radius + 1)
        around = [measured_point(depth, K, u, v) for v in window[0] for u in window[1]]
        before = all(q is None or q[2] < p[2] - tolerance for q in around)
        occluded.append(before or not (0 <= u0 < width and 0 <= v0 < height))
    return np.array(occluded, bool)


def explained_points(T, points, tangents, boundary, boundary_tangents, gate, depth_gate, min_cosine):
    """Return (N,) whether any posed point of like tangent is near."""
    points_cam, tangents_cam = posed(T, points, tangents)
    explained = []
    for q, t in zip(boundary, boundary_tangents, strict=True):
        near = [gated_distance(p - q, q, gate, depth_gate) <= gate for p in points_cam]
        explained.append(any(n and abs(s @ t) >= min_cosine for n, s in zip(near, tangents_cam, strict=True)))
    return np.array(explained, bool)


def near_points(T, points, visible, boundary, gate):
    """Return the indices of the boundary points with any visible posed sample near."""
    shown = [p for p, v in zip(posed(T, points, points)[0], visible, strict=True) if v]
    return [n for n, q in enumerate(boundary) if any(math.dist(p, q) <= gate for p in shown)]
