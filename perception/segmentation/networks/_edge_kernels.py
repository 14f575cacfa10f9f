"""Compiled passes over the edges of a graph: arrays in, arrays out; statistics in float64.

An edge (i, e) leads from point i to its neighbour j = neighbours[i, e]. Its sums are ``there[j] + here[i]``. Sums that
are stored are the rows of ``there``, one for each edge, and ``here`` is 0. ``scale`` and ``shift`` are those of the
normalisation, as factor and summand of the sums.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Reals = NDArray[np.floating]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True)
def sum_statistics(there: Reals, here: Reals, neighbours: Ints) -> Reals:
    """Return (2, C): for each channel, the sum over all edges of the sums of an edge, and of their squares."""
    count, k = neighbours.shape
    channels = there.shape[1]
    total = np.zeros((2, channels), np.float64)
    for i in range(count):
        for e in range(k):
            j = neighbours[i, e]
            for c in range(channels):
                value = there[j, c] + here[i, c]
                total[0, c] += value
                total[1, c] += np.float64(value) * value
    return total


@njit(cache=True, nogil=True)
def activated_sums(
    there: Reals, here: Reals, neighbours: Ints, scale: Reals, shift: Reals, slope: float, out: Reals
) -> None:
    """Write the (N, K, C) activations of the sums to ``out``."""
    count, k = neighbours.shape
    channels = there.shape[1]
    for i in range(count):
        for e in range(k):
            j = neighbours[i, e]
            for c in range(channels):
                value = (there[j, c] + here[i, c]) * scale[c] + shift[c]
                out[i, e, c] = value if value > 0 else value * slope


@njit(cache=True, nogil=True)
def activation_totals(
    there: Reals, here: Reals, neighbours: Ints, scale: Reals, shift: Reals, slope: float, gradient: Reals
) -> Reals:
    """Return (2, C) totals over all edges: of the (N, K, C) gradient behind the ReLU, and of it times the sums."""
    count, k = neighbours.shape
    channels = there.shape[1]
    total = np.zeros((2, channels), np.float64)
    for i in range(count):
        for e in range(k):
            j = neighbours[i, e]
            for c in range(channels):
                value = there[j, c] + here[i, c]
                slow = gradient[i, e, c] * slope
                through = gradient[i, e, c] if value * scale[c] + shift[c] > 0 else slow
                total[0, c] += through
                total[1, c] += np.float64(through) * value
    return total


@njit(cache=True, nogil=True)
def sum_gradients(
    there: Reals,
    here: Reals,
    neighbours: Ints,
    scale: Reals,
    shift: Reals,
    slope: float,
    factors: Reals,
    gradient: Reals,
    by_there: Reals,
    by_here: Reals,
) -> None:
    """Add the gradients by ``there`` and ``here`` for the (N, K, C) gradient by the activations.

    With g behind the ReLU, the gradient by the sums of an edge is ``factors[0] * g + factors[1] * sums + factors[2]``.
    """
    count, k = neighbours.shape
    channels = there.shape[1]
    for i in range(count):
        for e in range(k):
            j = neighbours[i, e]
            for c in range(channels):
                value = there[j, c] + here[i, c]
                slow = gradient[i, e, c] * slope
                through = gradient[i, e, c] if value * scale[c] + shift[c] > 0 else slow
                part = factors[0, c] * through + factors[1, c] * value + factors[2, c]
                by_there[j, c] += part
                by_here[i, c] += part


@njit(cache=True, nogil=True)
def sum_extremes(there: Reals, here: Reals, neighbours: Ints, signs: Reals, largest: Reals, which: Ints) -> Reals:
    """Find the largest of the sums times ``signs`` over the edges of a point; return totals as of `sum_statistics`.

    Args:
        there: Summands of the neighbours.
        here: (N, C) summands of the points.
        neighbours: (N, K) rows of ``there``.
        signs: (C,) sign of the normalisation's scale, by which the maximum after it is one of the sums.
        largest: (N, C) array for the sums that are largest.
        which: (N, C) array for their neighbours.
    """
    count, k = neighbours.shape
    channels = there.shape[1]
    total = np.zeros((2, channels), np.float64)
    for i in range(count):
        j = neighbours[i, 0]
        for c in range(channels):
            largest[i, c] = there[j, c] + here[i, c]
            which[i, c] = j
        for e in range(k):
            j = neighbours[i, e]
            for c in range(channels):
                value = there[j, c] + here[i, c]
                total[0, c] += value
                total[1, c] += np.float64(value) * value
                more = value * signs[c] > largest[i, c] * signs[c]
                largest[i, c] = value if more else largest[i, c]
                which[i, c] = j if more else which[i, c]
    return total


@njit(cache=True, nogil=True)
def extreme_gradients(
    there: Reals,
    here: Reals,
    neighbours: Ints,
    factors: Reals,
    through: Reals,
    which: Ints,
    by_there: Reals,
    by_here: Reals,
) -> None:
    """Add the gradients by ``there`` and ``here`` for the (N, C) gradient by the normalised largest of each point."""
    count, k = neighbours.shape
    channels = there.shape[1]
    for i in range(count):
        for e in range(k):
            j = neighbours[i, e]
            for c in range(channels):
                part = factors[1, c] * (there[j, c] + here[i, c]) + factors[2, c]
                by_there[j, c] += part
                by_here[i, c] += part
        for c in range(channels):
            part = factors[0, c] * through[i, c]
            by_there[which[i, c], c] += part
            by_here[i, c] += part


@njit(cache=True, nogil=True)
def most_similar(scores: Reals, first: int, found: Ints) -> None:
    """Write the columns of the k largest of each row of (R, N) scores to ``found[first : first + R]``, unsorted.

    Of equal ones the first columns count.
    """
    rows, columns = scores.shape
    k = found.shape[1]
    kept = np.empty(k, scores.dtype)
    for r in range(rows):
        out = found[first + r]
        for j in range(k):
            kept[j] = scores[r, j]
            out[j] = j
        low = 0
        for j in range(1, k):
            if kept[j] <= kept[low]:
                low = j
        for j in range(k, columns):
            if scores[r, j] > kept[low]:
                kept[low] = scores[r, j]
                out[low] = j
                low = 0
                for e in range(1, k):
                    if kept[e] < kept[low] or (kept[e] == kept[low] and out[e] > out[low]):
                        low = e
