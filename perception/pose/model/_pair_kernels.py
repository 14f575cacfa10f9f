"""Compiled kernels of point pair features: arrays in, arrays out, no threads and no fast maths.

Angles about a tangent are integers: a full turn is 2**8 units in the table.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats

Ints = NDArray[np.int64]
Votes = NDArray[np.int32]


class FeatureGrid(NamedTuple):
    """Cells of the pair feature in absolute units.

    Attributes:
        distance_step: Width of a cell along the distance of the two points [m].
        angle_step: Width of a cell along each angle [rad].
        distance_noise: Error of a distance that a look-up allows for [m].
        angle_noise: Error of an angle that a look-up allows for [rad].
        nearest: Smallest distance of a pair [m].
        collinear: Smallest angle between d and the reference's tangent [rad].
        distances: Number of cells along the distance.
        inclinations: Number of cells along the angle between d and a tangent.
        half_turns: Number of cells along the angle between the tangents.
        folded: Whether tangents are turned towards d, so that their angles to it are at most a right angle.
        flips: Whether the table stores if the reference's tangent was turned; needs ``folded``.
    """

    distance_step: float
    angle_step: float
    distance_noise: float
    angle_noise: float
    nearest: float
    collinear: float
    distances: int
    inclinations: int
    half_turns: int
    folded: bool
    flips: bool


@njit(cache=True, nogil=True)
def tangent_frames(tangents: Floats) -> Floats:
    """Return (N, 3, 3) rotations that map each unit tangent to x; the rotation about x is arbitrary but fixed."""
    frames = np.empty((len(tangents), 3, 3))
    for n in range(len(tangents)):
        # x is the tangent, y is perpendicular to it and to the axis it is least along, and z completes the frame.
        t = tangents[n]
        k = np.argmin(np.abs(t))
        a, b = (k + 1) % 3, (k + 2) % 3
        length = math.sqrt(t[a] * t[a] + t[b] * t[b])
        frames[n, 0] = t
        frames[n, 1, k], frames[n, 1, a], frames[n, 1, b] = 0.0, t[b] / length, -t[a] / length
        y = frames[n, 1]
        frames[n, 2, 0] = t[1] * y[2] - t[2] * y[1]
        frames[n, 2, 1] = t[2] * y[0] - t[0] * y[2]
        frames[n, 2, 2] = t[0] * y[1] - t[1] * y[0]
    return frames


@njit(cache=True, nogil=True)
def orbits(places: Floats, directions: Floats, distance: float, cosine: float) -> tuple[Ints, Ints, Ints]:
    """Group points that are alike under some rotation; the first point of an orbit, under its first one, represents it.

    Args:
        places: (M, S, 3) each point under each rotation [m].
        directions: (M, S, 3) unit tangents likewise, of any sign.
        distance: Largest distance from the representative [m].
        cosine: Smallest cosine of the angle between the tangents.

    Returns:
        (M,) orbit of each point, (M,) rotation that brings it to its representative, (R,) representatives.
    """
    members, chosen = np.zeros(len(places), np.int64), np.zeros(len(places), np.int64)
    representatives = np.empty(len(places), np.int64)
    count = 0
    for m in range(len(places)):
        orbit = -1
        for o in range(count):
            place, along = places[representatives[o], 0], directions[representatives[o], 0]
            for s in range(places.shape[1]):
                apart, turned = places[m, s], directions[m, s]
                x, y, z = apart[0] - place[0], apart[1] - place[1], apart[2] - place[2]
                if math.sqrt(x * x + y * y + z * z) > distance:
                    continue
                if abs(turned[0] * along[0] + turned[1] * along[1] + turned[2] * along[2]) >= cosine:
                    orbit, chosen[m] = o, s
                    break
            if orbit >= 0:
                break
        if orbit < 0:
            orbit = count
            representatives[count] = m
            count += 1
        members[m] = orbit
    return members, chosen, representatives[:count].copy()


@njit(cache=True, nogil=True)
def pair_feature(
    points: Floats, tangents: Floats, frame: Floats, r: int, i: int, nearest: float, farthest: float
) -> tuple[float, float, float, float, float]:
    """Return (|d|, cos(t_r, d), cos(t_i, d), cos(t_r, t_i), angle of d about t_r); |d| is 0 if out of range."""
    x, y, z = points[i, 0] - points[r, 0], points[i, 1] - points[r, 1], points[i, 2] - points[r, 2]
    square = x * x + y * y + z * z
    if square <= nearest * nearest or square >= farthest * farthest:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    length = math.sqrt(square)
    a, b = tangents[r], tangents[i]
    cos_r = max(-1.0, min(1.0, (a[0] * x + a[1] * y + a[2] * z) / length))
    cos_i = max(-1.0, min(1.0, (b[0] * x + b[1] * y + b[2] * z) / length))
    between = max(-1.0, min(1.0, a[0] * b[0] + a[1] * b[1] + a[2] * b[2]))
    along_y = frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z
    along_z = frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z
    return length, cos_r, cos_i, between, math.atan2(along_z, along_y)


@njit(cache=True, nogil=True)
def cell_of(value: float, density: float, count: int) -> int:
    """Return the cell of a value that is not negative; ``density`` is cells per unit of the value."""
    return min(int(value * density), count - 1)


@njit(cache=True, nogil=True)
def cells_of(value: float, density: float, noise: float, count: int) -> tuple[int, int]:
    """Return the first and the last cell that a value with an error of up to ``noise`` may belong to."""
    return cell_of(max(value - noise, 0.0), density, count), cell_of(value + noise, density, count)


@njit(cache=True, nogil=True)
def model_pairs(
    points: Floats, tangents: Floats, frames: Floats, rows: Ints, visibility: NDArray[np.uint32], grid: FeatureGrid
) -> Ints:
    """Return one number per admissible ordered pair: ``cell << 32 | row << 9 | sign << 8 | angle``.

    The angle is that of ``d`` in the reference's frame, negated where the sign bit is set (t_r.d < 0). So the part's
    rotation about the tangent is ``a_scene - angle`` for a scene pair of positive sign and ``a_scene + angle``
    otherwise, whether the tangent is flipped or not. Without ``grid.flips`` no sign bit is set.

    Args:
        points: (M, 3) edge points, part frame [m].
        tangents: (M, 3) unit tangents of the edges.
        frames: (M, 3, 3) rotation in which the pairs of each reference are seen.
        rows: (M,) accumulator row of each reference.
        visibility: (M,) bit mask of the views that see each point; pairs without a common bit are left out.
        grid: Cells of the pair feature.
    """
    out = np.empty(len(points) * len(points), np.int64)
    count = 0
    farthest = grid.distances * grid.distance_step
    straight = math.cos(grid.collinear)
    per_metre, per_radian = 1.0 / grid.distance_step, 1.0 / grid.angle_step
    for r in range(len(points)):
        for i in range(len(points)):
            if visibility[r] & visibility[i] == 0:
                continue
            length, cos_r, cos_i, between, turn = pair_feature(
                points, tangents, frames[r], r, i, grid.nearest, farthest
            )
            if length == 0.0 or abs(cos_r) > straight:
                continue
            # Cells of the four features; folding takes both tangents along d.
            f1 = cell_of(length, per_metre, grid.distances)
            f2 = cell_of(math.acos(abs(cos_r) if grid.folded else cos_r), per_radian, grid.inclinations)
            f3 = cell_of(math.acos(abs(cos_i) if grid.folded else cos_i), per_radian, grid.inclinations)
            opposed = grid.folded and (cos_r < 0) != (cos_i < 0)
            f4 = cell_of(math.acos(-between if opposed else between), per_radian, grid.half_turns)
            # The angle of d about the tangent, in 256ths of a full turn.
            sign = 1 if grid.flips and cos_r < 0 else 0
            angle = math.floor((-turn if sign else turn) * (256 / (2 * math.pi))) & 255
            cell = ((f1 * grid.inclinations + f2) * grid.inclinations + f3) * grid.half_turns + f4
            out[count] = (cell << 32) | (rows[r] << 9) | (sign << 8) | angle
            count += 1
    return out[:count]
