"""Plain loops for ScanNet's average precision: sets of points, one threshold, one class, one pair at a time.

A scene is (ids, classes, ignored, predictions): the instance of every point, the class and the exemption of every
instance, and (set of points, score, label) of every prediction.
"""

import math


def average_precision(scenes, overlap, label, min_region):
    """Return the area of one class at one overlap over all scenes, by the benchmark's centred steps."""
    verdicts, truths = [], 0
    for scene in scenes:
        found, number = _judge(*scene, overlap, label, min_region)
        verdicts += found
        truths += number
    if not truths:
        return math.nan
    points = []
    for accepted in sorted({score for score, _ in verdicts}):
        right = sum(correct for score, correct in verdicts if score >= accepted)
        every = sum(score >= accepted for score, _ in verdicts)
        points.append((right / every, right / truths))
    points.append((1.0, 0.0))
    recall = [points[0][1], *(r for _, r in points), 0.0]
    return sum(p * (recall[k] - recall[k + 2]) / 2 for k, (p, _) in enumerate(points))


def _judge(ids, classes, ignored, predictions, overlap, label, min_region):
    """Return the (score, correct) of one scene and how many instances had to be found."""
    regions = [{n for n, i in enumerate(ids) if i == p} for p in range(len(classes))]
    mine = [p for p in range(len(classes)) if classes[p] == label and regions[p]]
    to_find = [p for p in mine if not ignored[p] and len(regions[p]) >= min_region]
    candidates = [(points, score) for points, score, of in predictions if of == label and len(points) >= min_region]
    visited, verdicts = set(), []
    for p in to_find:
        best = None
        for k, (points, score) in enumerate(candidates):
            if k in visited or iou(points, regions[p]) <= overlap:
                continue
            if best is None:
                best = score
                visited.add(k)
            else:
                verdicts.append((min(best, score), False))
                best = max(best, score)
        if best is not None:
            verdicts.append((best, True))
    for points, score in candidates:
        if any(iou(points, regions[p]) > overlap for p in mine):
            continue
        excused = sum(ids[n] == -1 for n in points)
        excused += sum(len(points & regions[p]) for p in mine if p not in to_find)
        if excused / len(points) <= overlap:
            verdicts.append((score, False))
    return verdicts, len(to_find)


def iou(a, b):
    """Return the intersection over the union of two sets."""
    return len(a & b) / len(a | b)
