"""Compiled kernels of voting: arrays in, arrays out, no threads and no fast maths (same arrays, same bits).

Angles about a tangent are integers: a full turn is 2**16 units in the scene and 2**8 in the table. Votes are integers,
so that they do not depend on the order in which they are cast.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats
from perception.pose.model._pair_kernels import FeatureGrid, Ints, Votes, cells_of, pair_feature


@njit(cache=True, nogil=True)
def _cast(
    votes: Votes, entries: NDArray[np.uint32], start: int, stop: int, weight: int, turn: int, sign: int, bins: int
) -> None:
    """Add ``weight`` to (row, flip, bin) of the entries from ``start`` to ``stop``; ``votes`` is flat."""
    # All numbers are unsigned, because a signed index would be tested for a negative value. The part's rotation is
    # ``turn - angle``, or ``turn + angle`` for sign 1, modulo 2**16, where -x is (x ^ 65535) + 1.
    flip, width, eight = np.uint64(sign), np.uint64(bins), np.uint64(8)
    invert, first = np.uint64(0 if sign else 65535), np.uint64(turn + (0 if sign else 1))
    for e in range(start, stop):
        entry = np.uint64(entries[e])
        angle = ((entry & np.uint64(255)) << eight) | np.uint64(128)
        turned = (first + (angle ^ invert)) & np.uint64(65535)
        votes[((entry >> eight) ^ flip) * width + ((turned * width) >> np.uint64(16))] += weight


@njit(cache=True, nogil=True)
def accumulate(
    votes: Votes,
    points: Floats,
    tangents: Floats,
    frame: Floats,
    r: int,
    offsets: NDArray[np.int32],
    entries: NDArray[np.uint32],
    weights: Votes,
    grid: FeatureGrid,
) -> None:
    """Add the votes of all pairs (r, i) to ``votes``.

    A pair reads every cell within the noise, at most two along each axis. It reads both signs of a tangent that is
    perpendicular to ``d`` within half an angle step. It reads no cell twice for one sign. Without ``grid.flips`` all
    votes have sign 0, and no cell is read twice.

    Args:
        votes: (2 R, B) votes for each row, flip and bin of the rotation; changed in place.
        points: (N, 3) points of the scene, camera frame [m].
        tangents: (N, 3) unit tangents of these points.
        frame: (3, 3) rotation that maps the reference's tangent to x.
        r: Index of the reference.
        offsets: (C + 1,) index of each cell's first entry.
        entries: (E,) table entries of :func:`model_pairs` without the cell.
        weights: (C,) weight of the entries of each cell.
        grid: Cells of the pair feature.
    """
    farthest = grid.distances * grid.distance_step
    straight, square = math.cos(grid.collinear), math.sin(grid.angle_step / 2) if grid.folded else 0.0
    per_metre, per_radian = 1.0 / grid.distance_step, 1.0 / grid.angle_step
    bins, flat = votes.shape[1], votes.reshape(-1)
    for i in range(len(points)):
        length, cos_r, cos_i, between, angle = pair_feature(points, tangents, frame, r, i, grid.nearest, farthest)
        if length == 0.0 or abs(cos_r) > straight:
            continue
        # Ranges of cells along each feature; that between the tangents depends on whether one of them is flipped.
        low1, high1 = cells_of(length, per_metre, grid.distance_noise, grid.distances)
        angle_r = math.acos(abs(cos_r) if grid.folded else cos_r)
        angle_i = math.acos(abs(cos_i) if grid.folded else cos_i)
        low2, high2 = cells_of(angle_r, per_radian, grid.angle_noise, grid.inclinations)
        low3, high3 = cells_of(angle_i, per_radian, grid.angle_noise, grid.inclinations)
        f4 = math.acos(between)
        like = cells_of(f4, per_radian, grid.angle_noise, grid.half_turns)
        unlike = cells_of(math.pi - f4, per_radian, grid.angle_noise, grid.half_turns)
        turn = math.floor(angle * (65536 / (2 * math.pi))) & 65535
        # Cast the votes of the sign that the tangent has, and those of the other one if it is nearly perpendicular.
        for sign in range(2):
            if sign != (1 if cos_r < 0 else 0) and (abs(cos_r) >= square or not grid.flips):
                continue
            opposed = grid.folded and (sign == 1) != (cos_i < 0)
            first, second = (unlike, like) if opposed else (like, unlike)
            if abs(cos_i) >= square and (abs(cos_r) >= square or grid.flips):
                second = (1, 0)
            flip = sign if grid.flips else 0
            # All cells in range; along the last feature both ranges, without what they have in common.
            for f1 in range(low1, high1 + 1):
                for f2 in range(low2, high2 + 1):
                    for f3 in range(low3, high3 + 1):
                        base = ((f1 * grid.inclinations + f2) * grid.inclinations + f3) * grid.half_turns
                        for f in range(first[0], first[1] + 1):
                            c = base + f
                            _cast(flat, entries, offsets[c], offsets[c + 1], weights[c], turn, flip, bins)
                        for f in range(second[0], second[1] + 1):
                            c = base + f
                            if f < first[0] or f > first[1]:
                                _cast(flat, entries, offsets[c], offsets[c + 1], weights[c], turn, flip, bins)


@njit(cache=True, nogil=True)
def _smooth(votes: Votes, k: int, b: int) -> int:
    """Return four times the smoothed votes of bin ``b``; its neighbours on the circle of bins count half."""
    bins = votes.shape[1]
    before = votes[k, b - 1 if b > 0 else bins - 1]
    after = votes[k, b + 1 if b + 1 < bins else 0]
    return int(before) + 2 * int(votes[k, b]) + int(after)


@njit(cache=True, nogil=True)
def _pose(
    votes: Votes, k: int, b: int, point: Floats, frame: Floats, model_points: Floats, model_frames: Floats, T: Floats
) -> None:
    """Write to ``T`` the pose of peak (k, b); its rotation is interpolated between neighbouring bins."""
    bins = votes.shape[1]
    before = float(votes[k, b - 1 if b > 0 else bins - 1])
    after = float(votes[k, b + 1 if b + 1 < bins else 0])
    turn = (b + 0.5 + (after - before) / (before + float(votes[k, b]) + after)) * 2 * math.pi / bins
    c, s = math.cos(turn), math.sin(turn)
    side = -1.0 if k % 2 else 1.0
    m = model_frames[k // 2]
    # R = F_s^T Rx(turn) F_m, with Ry(pi) = diag(-1, 1, -1) before F_m where the tangents point against each other.
    T[:] = 0.0
    T[3, 3] = 1.0
    for j in range(3):
        x, y, z = side * m[0, j], m[1, j], side * m[2, j]
        y, z = c * y - s * z, s * y + c * z
        for i in range(3):
            T[i, j] = frame[0, i] * x + frame[1, i] * y + frame[2, i] * z
    p = model_points[k // 2]
    for i in range(3):
        T[i, 3] = point[i] - (T[i, 0] * p[0] + T[i, 1] * p[1] + T[i, 2] * p[2])


@njit(cache=True, nogil=True)
def _differ(T_a: Floats, T_b: Floats, centre: Floats, distance: float, cosine: float) -> bool:
    """Return whether two poses differ by more than ``distance`` at ``centre`` or by more than acos(cosine)."""
    square, trace = 0.0, 0.0
    for i in range(3):
        offset = T_a[i, 3] - T_b[i, 3]
        for j in range(3):
            offset += (T_a[i, j] - T_b[i, j]) * centre[j]
            trace += T_a[i, j] * T_b[i, j]
        square += offset * offset
    return square > distance * distance or (trace - 1) / 2 < cosine


@njit(cache=True, nogil=True)
def _find_peaks(
    votes: Votes,
    highest: Votes,
    point: Floats,
    frame: Floats,
    model_points: Floats,
    model_frames: Floats,
    centre: Floats,
    share: float,
    distance: float,
    cosine: float,
    T: Floats,
    score: Ints,
) -> None:
    """Write the best peak and the second best to ``T`` (2, 4, 4) and ``score`` (2,).

    Of equal peaks the one of the lowest row, flip and bin is taken. The second peak must have ``share`` of the votes of
    the best one and a different pose; otherwise its score is 0.
    """
    # The highest bin of each row.
    for k in range(len(votes)):
        top = np.int32(0)
        for b in range(votes.shape[1]):
            top = max(top, votes[k, b])
        highest[k] = top
    # The best peak.
    best_k, best_b = 0, 0
    for k in range(len(votes)):
        # Smoothed votes are at most four times the highest bin of a row: most rows need no smoothing.
        if 4 * int(highest[k]) > score[0]:
            for b in range(votes.shape[1]):
                here = _smooth(votes, k, b)
                if here > score[0]:
                    score[0], best_k, best_b = here, k, b
    if score[0] == 0:
        return
    _pose(votes, best_k, best_b, point, frame, model_points, model_frames, T[0])
    # The second peak, among those whose pose differs.
    other = np.empty((4, 4))
    for k in range(len(votes)):
        if 4 * int(highest[k]) < share * score[0]:
            continue
        for b in range(votes.shape[1]):
            here = _smooth(votes, k, b)
            if here > score[1] and here >= share * score[0]:
                _pose(votes, k, b, point, frame, model_points, model_frames, other)
                if _differ(T[0], other, centre, distance, cosine):
                    score[1] = here
                    T[1] = other


@njit(cache=True, nogil=True)
def vote_references(
    points: Floats,
    tangents: Floats,
    frames: Floats,
    references: Ints,
    offsets: NDArray[np.int32],
    entries: NDArray[np.uint32],
    weights: Votes,
    grid: FeatureGrid,
    bins: int,
    model_points: Floats,
    model_frames: Floats,
    centre: Floats,
    share: float,
    distance: float,
    cosine: float,
) -> tuple[Floats, Ints]:
    """Return the (Q, 2, 4, 4) poses of the two best peaks of each reference and their (Q, 2) votes, 0 for no peak.

    Votes are smoothed sums of weights, four times those of a bin.

    Args:
        points: (N, 3) points of the scene, camera frame [m].
        tangents: (N, 3) unit tangents of these points.
        frames: (N, 3, 3) rotation that maps each tangent to x.
        references: (Q,) indices of the reference points.
        offsets: (C + 1,) index of each cell's first entry.
        entries: (E,) table entries of :func:`model_pairs` without the cell.
        weights: (C,) weight of the entries of each cell.
        grid: Cells of the pair feature.
        bins: Number B of bins of the rotation about the tangent.
        model_points: (R, 3) model point of each accumulator row, part frame [m].
        model_frames: (R, 3, 3) rotation that maps the tangent of each row's point to x.
        centre: (3,) point of the part at which poses are compared, part frame [m].
        share: Least share of the best peak's votes that a second peak must have.
        distance: Distance at the centre above which poses differ [m].
        cosine: Cosine of the angle above which poses differ.
    """
    T = np.zeros((len(references), 2, 4, 4))
    score = np.zeros((len(references), 2), np.int64)
    votes = np.empty((2 * len(model_points), bins), np.int32)
    highest = np.empty(len(votes), np.int32)
    for q in range(len(references)):
        r = references[q]
        votes[:] = 0
        accumulate(votes, points, tangents, frames[r], r, offsets, entries, weights, grid)
        _find_peaks(
            votes,
            highest,
            points[r],
            frames[r],
            model_points,
            model_frames,
            centre,
            share,
            distance,
            cosine,
            T[q],
            score[q],
        )
    return T, score
