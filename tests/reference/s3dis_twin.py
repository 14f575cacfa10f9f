"""Plain loops for S3DIS: reading text, cutting blocks, merging them."""

import math
from collections import Counter
from itertools import combinations


def read_points(text):
    """Return (x, y, z, red, green, blue) rows of a text, or the number of its first bad line."""
    rows = []
    for number, line in enumerate(text.split("\n"), start=1):
        words = line.replace("\t", " ").replace("\r", " ").split(" ")
        words = [word for word in words if word]
        if not words:
            continue
        try:
            values = [float(word) for word in words]
        except ValueError:
            return number
        colours = values[3:]
        if len(values) != 6 or any(not 0 <= c <= 255 or c != int(c) for c in colours):
            return number
        rows.append(values)
    return rows


def find_blocks(xyz, size, stride, least, cover):
    """Return (corner x, corner y, indices), x, y from the least; as the released code walks."""
    low = [min(float(p[k]) for p in xyz) for k in range(2)]
    plan = [[float(p[k]) - low[k] for k in range(2)] for p in xyz]
    counts = [max(math.ceil((max(p[k] for p in plan) - size) / stride), 0) + 1 for k in range(2)]
    every = []
    for i in range(counts[0]):
        columns = list(range(counts[1]))
        for j in columns if i % 2 == 0 else reversed(columns):
            x, y = i * stride, j * stride
            inside = [n for n, (a, b) in enumerate(plan) if x <= a <= x + size and y <= b <= y + size]
            every.append((x, y, inside))
    covered = {n for _, _, inside in every if len(inside) >= least for n in inside}
    kept = []
    for x, y, inside in every:
        if len(inside) >= least or (cover and not covered.issuperset(inside)):
            covered.update(inside)
            kept.append((x, y, inside))
    return kept


def merge(xyz, samples, *, cell, min_hits, min_points, exclusive, rejoin):
    """Return the label of each point; ``samples`` are (point_idx, groups, categories)."""
    low = [min(float(p[k]) for p in xyz) for k in range(3)]
    cell_of = [tuple(int((float(p[k]) - low[k]) / cell) for k in range(3)) for p in xyz]
    owner, labels, begun, evidence = {}, [-1] * len(xyz), 0, Counter()
    for point_idx, groups, categories in samples:
        members = {g: [n for n, k in enumerate(groups) if k == g] for g in sorted(set(groups)) if g >= 0}
        category, hits, best, objects = {}, {}, {}, {}
        for g, rows in members.items():
            votes = Counter(categories[n] for n in rows)
            category[g] = min(votes, key=lambda c: (-votes[c], c))
            found = Counter(owner.get((cell_of[point_idx[n]], category[g]), -1) for n in rows)
            hits[g] = {o: n for o, n in found.items() if o >= 0 and n >= min_hits}
            if hits[g]:
                best[g] = min(hits[g], key=lambda o: (-hits[g][o], o))
        for g, o in best.items():
            rivals = [h for h in best if best[h] == o]
            if not exclusive or g == min(rivals, key=lambda h: (-hits[h][o], h)):
                objects[g] = o
        for g, rows in members.items():
            if g not in objects and len(rows) > min_points:
                objects[g] = begun
                begun += 1
        for found in hits.values():
            for a, b in combinations(sorted(found), 2):
                evidence[a, b] += min(found[a], found[b])
        for g, h in combinations(objects, 2):
            if objects[g] != objects[h] and category[g] == category[h]:
                a, b = sorted((objects[g], objects[h]))
                evidence[a, b] -= min(len(members[g]), len(members[h]))
        free = {(cell_of[point_idx[n]], category[g]) for g, rows in members.items() for n in rows} - set(owner)
        for n, g in enumerate(groups):
            if g in objects:
                point = point_idx[n]
                if labels[point] < 0:
                    labels[point] = objects[g]
                place = (cell_of[point], category[g])
                if place in free:
                    free.remove(place)
                    owner[place] = objects[g]
    roots = list(range(begun))
    while rejoin and evidence:
        a, b = max(evidence, key=lambda pair: (evidence[pair], -pair[0], -pair[1]))
        if evidence[a, b] <= 0:
            break
        roots = [a if root == b else root for root in roots]
        summed = Counter()
        for (c, d), points in evidence.items():
            e, f = sorted((a if c == b else c, a if d == b else d))
            if e != f:
                summed[e, f] += points
        evidence = summed
    return [roots[label] if label >= 0 else -1 for label in labels]
