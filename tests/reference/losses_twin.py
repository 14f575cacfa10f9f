"""Plain loops for the loss terms: every cloud, every pair, one at a time, in Python's floats."""

import math


def mean_over_clouds(clouds, loss):
    """Return the mean of ``loss(cloud)`` over the clouds for which it is not None; 0 if there are none."""
    values = [value for value in map(loss, clouds) if value is not None]
    return sum(values) / len(values) if values else 0.0


def distance(config, a, b):
    square = sum((x - y) ** 2 for x, y in zip(a, b, strict=True))
    return math.sqrt(square) if config.distance == "l2" else 10 * square


def pair(config, alpha, d, *, same, same_class, near):
    """Return l(i, j) of eq. (1) or (2)."""
    if not same_class:
        return max(0.0, config.category - d)
    if not same:
        return alpha * max(0.0, config.other - d) if near else 0.0
    return d if config.kind == "double_hinge" else config.beta * max(0.0, d - config.same)


def pair_loss(embedding, ids, config, alpha, class_ids=None, points=None):
    def of_cloud(b):
        classes = [0] * len(ids[b]) if class_ids is None else class_ids[b]
        members = [i for i in range(len(ids[b])) if ids[b][i] != -1 and classes[i] != -1]
        sizes = {k: sum(ids[b][i] == k for i in members) for k in ids[b]}
        total = 0.0
        for i in members:
            for j in members:
                value = pair(
                    config,
                    alpha,
                    distance(config, embedding[b][i], embedding[b][j]),
                    same=ids[b][i] == ids[b][j],
                    same_class=classes[i] == classes[j],
                    near=config.reach is None or math.dist(points[b][i], points[b][j]) < config.reach,
                )
                if config.weighting == "inverse_frequency":
                    value *= len(members) / sizes[ids[b][i]] * len(members) / sizes[ids[b][j]]
                total += value
        return total / len(members) ** 2 if members else None

    return mean_over_clouds(range(len(ids)), of_cloud)


def confidence_loss(confidence, embedding, ids, config, threshold):
    def of_cloud(b):
        members = [i for i in range(len(ids[b])) if ids[b][i] != -1]
        errors = []
        for i in members:
            proposed = {j for j in members if distance(config, embedding[b][i], embedding[b][j]) < threshold}
            group = {j for j in members if ids[b][j] == ids[b][i]}
            errors.append((confidence[b][i] - len(proposed & group) / len(proposed | group)) ** 2)
        return sum(errors) / len(errors) if errors else None

    return mean_over_clouds(range(len(ids)), of_cloud)


def semantic_loss(logits, class_ids):
    def of_cloud(b):
        members = [i for i in range(len(class_ids[b])) if class_ids[b][i] != -1]
        values = [math.log(sum(map(math.exp, logits[b][i]))) - logits[b][i][class_ids[b][i]] for i in members]
        return sum(values) / len(values) if values else None

    return mean_over_clouds(range(len(class_ids)), of_cloud)


def offset_loss(offsets, targets, ids, delta):
    def huber(error):
        return error**2 / 2 if abs(error) <= delta else delta * (abs(error) - delta / 2)

    def of_cloud(b):
        members = [i for i in range(len(ids[b])) if ids[b][i] != -1]
        values = [sum(huber(x - y) for x, y in zip(offsets[b][i], targets[b][i], strict=True)) for i in members]
        return sum(values) / len(values) if values else None

    return mean_over_clouds(range(len(ids)), of_cloud)
