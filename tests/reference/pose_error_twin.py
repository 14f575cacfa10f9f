"""Plain loops for the pose errors: one point, one symmetry, one pixel, one threshold at a time.

A pose is a (4, 4) matrix, a group a list of (3, 3) rotations about ``centre``.
"""

import math


def move(T, point):
    return [sum(T[i][j] * point[j] for j in range(3)) + T[i][3] for i in range(3)]


def turn(rotation, centre, point):
    """Return ``point`` turned about ``centre``."""
    offset = [point[i] - centre[i] for i in range(3)]
    return [centre[i] + sum(rotation[i][j] * offset[j] for j in range(3)) for i in range(3)]


def translation_error(T_est, T_true, centre):
    return math.dist(move(T_est, centre), move(T_true, centre))


def rotation_error(T_est, T_true, group):
    return min(angle_between(T_est, T_true, g) for g in group)


def angle_between(T_est, T_true, g):
    turned = [[sum(T_true[i][k] * g[k][j] for k in range(3)) for j in range(3)] for i in range(3)]
    trace = sum(T_est[i][j] * turned[i][j] for i in range(3) for j in range(3))
    return math.acos(min(1.0, max(-1.0, (trace - 1) / 2)))


def add(T_est, T_true, points):
    return sum(math.dist(move(T_est, p), move(T_true, p)) for p in points) / len(points)


def add_s(T_est, T_true, points):
    return sum(min(math.dist(move(T_est, q), move(T_true, p)) for q in points) for p in points) / len(points)


def mssd(T_est, T_true, points, group, centre):
    return min(max(math.dist(move(T_est, p), move(T_true, turn(g, centre, p))) for p in points) for g in group)


def mspd(T_est, T_true, points, group, centre, K):
    worst = []
    for g in group:
        pairs = [(move(T_est, p), move(T_true, turn(g, centre, p))) for p in points]
        worst.append(max(math.dist(pixel(K, a), pixel(K, b)) for a, b in pairs))
    return min(worst)


def pixel(K, point):
    x, y, z = point
    return K[0][0] * x / z + K[0][2], K[1][1] * y / z + K[1][2]


def vsd(depth_est, depth_true, depth_scene, K, tau, delta):
    """Return the discrepancy for one tolerance [m]."""
    cost = union = 0
    for v in range(len(depth_true)):
        for u in range(len(depth_true[0])):
            stretch = math.hypot(1.0, (u - K[0][2]) / K[0][0], (v - K[1][2]) / K[1][1])
            est, true, scene = (image[v][u] * stretch for image in (depth_est, depth_true, depth_scene))
            seen_true = true > 0 and (scene == 0 or true - scene <= delta)
            seen_est = est > 0 and (scene == 0 or est - scene <= delta or seen_true)
            if seen_true or seen_est:
                union += 1
                cost += not (seen_true and seen_est and abs(est - true) < tau)
    return cost / union if union else 1.0


def surface_distance(T_a, T_b, triangles, group, centre):
    """Return Bregier's distance from its definition: an integral over the surface, least over the group.

    The mean over a triangle of a quadratic function is the mean over the middles of its edges.
    """
    least = math.inf
    for g in group:
        total = area = 0.0
        for a, b, c in triangles:
            size = triangle_area(a, b, c)
            for p, q in ((a, b), (b, c), (c, a)):
                middle = [(p[i] + q[i]) / 2 for i in range(3)]
                total += size / 3 * math.dist(move(T_a, middle), move(T_b, turn(g, centre, middle))) ** 2
            area += size
        least = min(least, math.sqrt(total / area))
    return least


def triangle_area(a, b, c):
    u, v = [b[i] - a[i] for i in range(3)], [c[i] - a[i] for i in range(3)]
    cross = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    return math.hypot(*cross) / 2


def average_precision(scenes, max_distance):
    """Return Bregier's average precision of scenes (distances, scores, to_find), counted anew at every score.

    An estimate and an instance are a match if each is the other's nearest.
    """
    area, recall = 0.0, 0.0
    for threshold in sorted({score for _, scores, _ in scenes for score in scores}, reverse=True):
        points = [count(*scene, max_distance, threshold) for scene in scenes]
        precisions = [right / (right + wrong) if right + wrong else 1.0 for right, wrong, _ in points]
        recalls = [right / truths for right, _, truths in points if truths]
        area += sum(precisions) / len(precisions) * (sum(recalls) / len(recalls) - recall)
        recall = sum(recalls) / len(recalls)
    return area


def count(distances, scores, to_find, max_distance, threshold):
    """Return how many estimates are right and wrong, and how many instances had to be found."""
    accepted = [e for e in range(len(scores)) if scores[e] >= threshold]
    right = wrong = 0
    for e in accepted:
        p = min(range(len(to_find)), key=lambda p: distances[e][p])
        nearest = min(accepted, key=lambda other: distances[other][p])
        if distances[e][p] >= max_distance or nearest != e:
            wrong += 1
        elif to_find[p]:
            right += 1
    return right, wrong, sum(to_find)
