"""Scenes whose groups are known, shared by the tests of the groupings."""

import numpy as np

D_MAX = 0.1


def blobs(rng, parts=6, count=400, width=8, apart=20.0, noise=1.0):
    """Return embedding, confidence, points and labels: parts of extent D_MAX in space, blobs in the embedding."""
    labels = rng.integers(0, parts, count)
    means = rng.permutation(np.eye(max(width, parts))[:parts, :width]) * apart
    embedding = means[labels] + rng.normal(size=(count, width)) * noise / np.sqrt(width)
    offsets = rng.uniform(-0.5, 0.5, (count, 3)) * D_MAX / np.sqrt(3)
    points = rng.uniform(0.0, 0.3, (parts, 3))[labels] + offsets
    return embedding.astype(np.float32), rng.uniform(0.2, 1.0, count), points, labels


def same_partition(a, b):
    """Whether two labellings group alike, whatever the numbers."""
    pairs = np.unique(np.stack([a, b]), axis=1)
    unique = all(len(np.unique(row)) == pairs.shape[1] for row in pairs)
    return unique and np.array_equal(a < 0, b < 0)


def bad(index, shape, value):
    """Return zeros with one value that does not belong there."""
    array = np.zeros(shape)
    array[index] = value
    return array
