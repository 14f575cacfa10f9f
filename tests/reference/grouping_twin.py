"""Plain loops for the groupings: every pair of points, one at a time."""

import math

import numpy as np


def square(a, b):
    return sum((float(x) - float(y)) ** 2 for x, y in zip(a, b, strict=True))


def fits(points, members, directions, reach):
    """Whether no direction sees the members extend by more than ``reach``."""
    if reach == math.inf:
        return True
    for u in directions:
        along = [sum(float(x) * float(y) for x, y in zip(points[i], u, strict=True)) for i in members]
        if max(along) - min(along) > reach:
            return False
    return True


def mean(embedding, members):
    return np.mean([embedding[i] for i in members], axis=0)


def trimmed(points, members, directions, reach):
    if fits(points, members, directions, reach):
        return members
    middle = np.median([points[i] for i in members], axis=0)
    kept = []
    for i in sorted(members, key=lambda i: square(points[i], middle)):
        if fits(points, [*kept, i], directions, reach):
            kept.append(i)
    return kept


def group_points(embedding, confidence, points, *, limit, reach, directions, refinements, min_points, nearest):
    """Return labels; ``limit`` is the squared embedding distance, ``reach`` the mask's; confidences must differ."""
    embedding = np.asarray(embedding, float)
    ranked = sorted(range(len(points)), key=lambda i: -confidence[i])
    rest, spent, cores = list(ranked), set(), []
    for seed in ranked:
        if seed in spent or seed not in rest:
            continue
        spent.add(seed)
        near = [i for i in rest if square(points[i], points[seed]) <= reach**2]
        centre = embedding[seed]
        members = [i for i in near if square(embedding[i], centre) < limit]
        for _ in range(refinements):
            centre = mean(embedding, members)
            members = [i for i in near if square(embedding[i], centre) < limit]
        if len(members) >= min_points:
            members = trimmed(points, members, directions, reach)
        if len(members) < min_points:
            spent.update(members)
            continue
        cores.append(members)
        rest = [i for i in rest if i not in members]
    while True:
        groups = assigned(embedding, points, ranked, cores, limit, reach, directions, nearest)
        if all(len(group) >= min_points for group in groups):
            break
        cores = [core for core, group in zip(cores, groups, strict=True) if len(group) >= min_points]
    labels = np.full(len(points), -1)
    for k, group in enumerate(groups):
        labels[group] = k
    return labels


def assigned(embedding, points, ranked, cores, limit, reach, directions, nearest):
    means = [mean(embedding, core) for core in cores]
    held = [list(core) for core in cores]
    groups = [[] for _ in cores]
    for bound in (limit, math.inf) if nearest else (limit,):
        for i in ranked:
            if any(i in group for group in groups):
                continue
            for distance, k in sorted((square(embedding[i], means[k]), k) for k in range(len(cores))):
                if distance < bound and fits(points, [*held[k], i], directions, reach):
                    held[k].append(i)
                    groups[k].append(i)
                    break
    return groups


def merge_groups(S, threshold, confidence, classes, *, min_confidence, min_proposal, iou, share, min_points):
    """Return labels by GroupMerging over a whole similarity matrix."""
    count = len(S)
    labels = [-1] * count
    painted = 0
    for kind in sorted(set(classes)):
        members = {i for i in range(count) if classes[i] == kind}
        proposals = []
        for i in sorted(members):
            if confidence[i] <= min_confidence:
                continue
            new = {j for j in members if S[i][j] < threshold}
            if len(new) <= min_proposal:
                continue
            known = False
            for k, old in enumerate(proposals):
                if len(new & old) / len(new | old) > iou or len(new & old) / len(new) > share:
                    known = True
                    if len(new) > len(old):
                        proposals[k] = new
            if not known:
                proposals.append(new)
        for proposal in proposals or [members]:
            if len(proposal) > min_points:
                for i in proposal:
                    labels[i] = painted
                painted += 1
    kept = [k for k in range(painted) if labels.count(k) >= min_points]
    labels = [kept.index(k) if k in kept else -1 for k in labels]
    for i in range(count):
        if labels[i] == -1:
            similar = [labels[j] for j in range(count) if S[i][j] < threshold and labels[j] >= 0]
            if similar:
                labels[i] = min(set(similar), key=lambda k: (-similar.count(k), k))
    return np.array(labels)


def components(points, radius):
    """Return labels of connected components by flooding from each point in turn."""
    labels = [-1] * len(points)
    for i in range(len(points)):
        if labels[i] >= 0:
            continue
        number, front = max(labels) + 1, [i]
        while front:
            a = front.pop()
            labels[a] = number
            front += [b for b in range(len(points)) if labels[b] < 0 and square(points[a], points[b]) <= radius**2]
    return np.array(labels)
