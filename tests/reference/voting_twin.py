"""Plain loops for pair features and voting: dictionaries of cells, one pair and one vote at a time."""

import math
from collections import defaultdict


def pair(points, tangents, frame, r, i):
    """Return |d|, the cosines of (t_r, d), (t_i, d) and (t_r, t_i), and the angle of d round t_r."""
    d = [float(points[i][k]) - float(points[r][k]) for k in range(3)]
    length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    if length == 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0

    def dot(a, b):
        return float(a[0]) * float(b[0]) + float(a[1]) * float(b[1]) + float(a[2]) * float(b[2])

    def clip(value):
        return max(-1.0, min(1.0, value))

    turn = math.atan2(dot(frame[2], d), dot(frame[1], d))
    cos_r, cos_i = clip(dot(tangents[r], d) / length), clip(dot(tangents[i], d) / length)
    return length, cos_r, cos_i, clip(dot(tangents[r], tangents[i])), turn


def cell(value, step, count):
    """Return the cell of a value, the last one for all beyond."""
    return min(int(value * (1.0 / step)), count - 1)


def cells(value, step, noise, count):
    """Return the cells that a value may belong to."""
    return set(range(cell(max(value - noise, 0.0), step, count), cell(value + noise, step, count) + 1))


def usable(length, cos_r, grid):
    """Tell whether a pair is neither too short nor too long nor straight along the reference's tangent."""
    far = grid.distances * grid.distance_step
    return grid.nearest < length < far and abs(cos_r) <= math.cos(grid.collinear)


def side(cosine, signs):
    """Return the sign that turns a tangent towards d."""
    return -1 if signs != "raw" and cosine < 0 else 1


def folded(cosine, signs):
    """Return the angle of a tangent to d, of the tangent that was turned unless signs come raw."""
    return math.acos(cosine if signs == "raw" else abs(cosine))


def table(points, tangents, frames, visibility, grid, signs="safe"):
    """Return {(f1, f2, f3, f4): set of (row, sign, angle)}."""
    out = defaultdict(set)
    for r in range(len(points)):
        for i in range(len(points)):
            length, cos_r, cos_i, between, turn = pair(points, tangents, frames[r], r, i)
            if not int(visibility[r]) & int(visibility[i]) or not usable(length, cos_r, grid):
                continue
            s_r, s_i = side(cos_r, signs), side(cos_i, signs)
            key = (
                cell(length, grid.distance_step, grid.distances),
                cell(folded(cos_r, signs), grid.angle_step, grid.inclinations),
                cell(folded(cos_i, signs), grid.angle_step, grid.inclinations),
                cell(math.acos(s_r * s_i * between), grid.angle_step, grid.half_turns),
            )
            if signs != "safe":
                s_r = 1
            out[key].add((r, int(s_r < 0), math.floor(s_r * turn * (256 / (2 * math.pi))) % 256))
    return out


def votes(entries, points, tangents, frame, r, grid, bins, signs="safe"):
    """Return {(row, flip, bin): votes} of one reference point, every entry counting 1."""
    out = defaultdict(int)
    square = math.sin(grid.angle_step / 2)
    for i in range(len(points)):
        length, cos_r, cos_i, between, turn = pair(points, tangents, frame, r, i)
        if not usable(length, cos_r, grid):
            continue
        s_r, s_i = side(cos_r, signs), side(cos_i, signs)
        looked_up = set()
        for sign_r in (s_r, -s_r) if abs(cos_r) < square and signs != "raw" else (s_r,):
            for sign_i in (s_i, -s_i) if abs(cos_i) < square and signs != "raw" else (s_i,):
                f4 = math.acos(between) if sign_r * sign_i > 0 else math.pi - math.acos(between)
                looked_up |= {
                    (sign_r if signs == "safe" else 1, (a, b, c, d))
                    for a in cells(length, grid.distance_step, grid.distance_noise, grid.distances)
                    for b in cells(folded(cos_r, signs), grid.angle_step, grid.angle_noise, grid.inclinations)
                    for c in cells(folded(cos_i, signs), grid.angle_step, grid.angle_noise, grid.inclinations)
                    for d in cells(f4, grid.angle_step, grid.angle_noise, grid.half_turns)
                }
        turn = math.floor(turn * (65536 / (2 * math.pi)))
        for sign_r, key in looked_up:
            for row, sign, angle in entries.get(key, ()):
                # The angle is stored negated where the model's sign is set.
                a_m = (-1 if sign else 1) * (256 * angle + 128)
                flip = int(bool(sign) != (sign_r < 0))
                alpha = (turn + a_m if flip else turn - a_m) % 65536
                out[row, flip, alpha * bins // 65536] += 1
    return out


def smoothed(row):
    """Return a circular row smoothed by (1, 2, 1)."""
    bins = len(row)
    return [int(row[b - 1]) + 2 * int(row[b]) + int(row[(b + 1) % bins]) for b in range(bins)]
