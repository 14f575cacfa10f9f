"""Families of sheet-metal and extruded profiles. y lies along the profile; the unit is its larger side in the section.

Sections are unions of convex polygons of (x, z) corners, which are the pieces.
"""

import numpy as np

from binpick_env.parts.families.drawing import Drawing, X, Y, chance, cyclic, dihedral
from binpick_env.parts.families.solid import Solid, box, cylinder, profile, revolved, rod, total


def l_bracket(rng: np.random.Generator) -> Drawing:
    """Angle bracket of two unequal legs with one or two holes each; the long leg lies along x."""
    short, wall, width = rng.uniform(0.5, 0.85), rng.uniform(0.06, 0.12), rng.uniform(0.35, 1.1)
    solid = profile(rectangle(0, 1, 0, wall), rectangle(0, wall, 0, short), width=width)
    hole = rng.uniform(0.12, 0.2)
    solid = solid - holes(hole, _row(width, hole, rng), x=0.65) - _upright(hole, _row(width, hole, rng), z=0.65 * short)
    return Drawing(solid=solid, wall=wall)


def gusset_bracket(rng: np.random.Generator) -> Drawing:
    """Angle bracket stiffened by one rib, or by two at its sides, with holes in both legs."""
    short, wall, width = rng.uniform(0.55, 0.85), rng.uniform(0.07, 0.12), rng.uniform(0.5, 1.0)
    rib, reach = rng.uniform(0.07, 0.12), rng.uniform(0.65, 0.95)
    solid = profile(rectangle(0, 1, 0, wall), rectangle(0, wall, 0, short), width=width)
    e = wall / 2
    triangle = [(e, e), (reach, e), (reach, wall), (wall, short * reach), (e, short * reach)]
    two, hole = chance(rng), rng.uniform(0.1, 0.15)
    offsets = (rib / 2 - width / 2, width / 2 - rib / 2) if two else (0.0,)
    solid += total(profile(triangle, width=rib).at(y=y) for y in offsets)
    rows = (0.0,) if two else (-width / 4 - rib / 4, width / 4 + rib / 4)
    solid = solid - holes(hole, rows, x=0.6) - _upright(hole, rows, z=0.6 * short)
    return Drawing(solid=solid, wall=min(wall, rib))


def z_bracket(rng: np.random.Generator) -> Drawing:
    """Z-shaped bracket: a web and two flanges to opposite sides, equal or not, with a row of holes in each."""
    height, wall, width = rng.uniform(0.45, 0.9), rng.uniform(0.06, 0.11), rng.uniform(0.4, 1.2)
    equal = chance(rng)
    left, right = 0.5, 0.5 if equal else rng.uniform(0.3, 0.42)
    web = rectangle(-wall / 2, wall / 2, 0, height)
    solid = profile(
        web, rectangle(-left, wall / 2, 0, wall), rectangle(-wall / 2, right, height - wall, height), width=width
    )
    hole = rng.uniform(0.1, 0.16)
    rows = _row(width, hole, rng)
    solid = solid - holes(hole, rows, x=-0.55 * left) - holes(hole, rows, x=0.55 * right)
    return Drawing(solid=solid, wall=wall, symmetry=cyclic(2, Y) if equal else cyclic(1))


def u_channel(rng: np.random.Generator) -> Drawing:
    """U-shaped channel with holes in its base."""
    height, wall, width = rng.uniform(0.4, 0.9), rng.uniform(0.07, 0.12), rng.uniform(0.6, 2.2)
    base = rectangle(-0.5, 0.5, 0, wall)
    sides = [rectangle(-0.5, wall - 0.5, 0, height), rectangle(0.5 - wall, 0.5, 0, height)]
    solid, hole = profile(base, *sides, width=width), rng.uniform(0.12, 0.22)
    solid -= holes(hole, (-0.3 * width, 0.3 * width) if width > 0.8 else (0.0,), x=0.0)
    return Drawing(solid=solid, wall=wall, symmetry=cyclic(2))


def hat_bracket(rng: np.random.Generator) -> Drawing:
    """Hat-shaped (omega) bracket: a roof on two walls, and a foot with holes at each side."""
    height, wall, width = rng.uniform(0.28, 0.5), rng.uniform(0.04, 0.07), rng.uniform(0.3, 0.9)
    roof, hole = rng.uniform(0.18, 0.26), rng.uniform(0.09, 0.13)
    half = [
        rectangle(roof - wall, roof, 0, height),
        rectangle(roof - wall, 0.5, 0, wall),
    ]
    top = rectangle(-roof, roof, height - wall, height)
    solid = profile(top, *half, *([(-x, z) for x, z in each] for each in half), width=width)
    rows, middle = _row(width, hole, rng), (roof + 0.5) / 2
    solid = solid - holes(hole, rows, x=middle) - holes(hole, rows, x=-middle)
    return Drawing(solid=solid, wall=wall, symmetry=cyclic(2))


def t_profile(rng: np.random.Generator) -> Drawing:
    """Length of T-section, with fillets drawn as chamfers; some have two holes in the web."""
    height, wall, width = rng.uniform(0.5, 1.0), rng.uniform(0.08, 0.15), rng.uniform(0.6, 2.6)
    web = wall * rng.uniform(0.8, 1.2)
    fillet = 0.3 * web
    foot = [(-web / 2 - fillet, wall), (web / 2 + fillet, wall), (web / 2, wall + fillet), (-web / 2, wall + fillet)]
    solid = profile(rectangle(-0.5, 0.5, 0, wall), rectangle(-web / 2, web / 2, wall / 2, height), foot, width=width)
    if chance(rng):
        hole = rng.uniform(0.15, 0.3) * height
        solid -= _upright(hole, (-0.3 * width, 0.3 * width), z=wall + 0.55 * (height - wall))
    return Drawing(solid=solid, wall=min(wall, web), symmetry=cyclic(2))


def square_tube(rng: np.random.Generator) -> Drawing:
    """Length of rectangular tube, open at both ends; some have a hole through two sides."""
    height, wall, width = rng.uniform(0.45, 0.85), rng.uniform(0.07, 0.12), rng.uniform(0.5, 2.4)
    h = height / 2
    walls = [rectangle(-0.5, 0.5, h - wall, h), rectangle(-0.5, 0.5, -h, wall - h)]
    walls += [rectangle(0.5 - wall, 0.5, -h, h), rectangle(-0.5, wall - 0.5, -h, h)]
    solid = profile(*walls, width=width)
    if chance(rng):
        solid -= cylinder(rng.uniform(0.2, 0.4), (-1.0, 1.0))
    return Drawing(solid=solid, wall=wall, symmetry=dihedral(2, axis=Y, across=X))


def pipe_clamp_half(rng: np.random.Generator) -> Drawing:
    """Half of a pipe clamp: a half ring over the pipe and a foot with a hole at each side."""
    inner, wall, width = rng.uniform(0.22, 0.3), rng.uniform(0.05, 0.09), rng.uniform(0.2, 0.6)
    gap, foot = rng.uniform(0.02, 0.04), rng.uniform(0.05, 0.09)
    half = width / 2
    arch = revolved(
        [(inner, -half), (inner + wall, -half), (inner + wall, half), (inner, half)], angle=180.0, sectors=6
    )
    solid = arch.rotated(x=90.0).at(z=gap)
    for side in (1.0, -1.0):
        solid += _box_of(side * inner, side * (inner + wall), half, (0.0, gap + 1e-3))
        solid += _box_of(side * (inner + wall / 2), side * 0.5, half, (0.0, foot))
    hole = min(0.5 * width, rng.uniform(0.07, 0.1))
    middle = (inner + wall + 0.5) / 2
    solid = solid - holes(hole, (0.0,), x=middle) - holes(hole, (0.0,), x=-middle)
    return Drawing(solid=solid, wall=min(wall, foot), symmetry=cyclic(2))


def rectangle(x0: float, x1: float, z0: float, z1: float) -> list[tuple[float, float]]:
    """Return the corners of a rectangle in the section."""
    return [(x0, z0), (x1, z0), (x1, z1), (x0, z1)]


def _row(width: float, hole: float, rng: np.random.Generator) -> tuple[float, ...]:
    """Draw one or two positions of holes along the width, symmetric about its middle."""
    return (-width / 4, width / 4) if width > 4 * hole and chance(rng, 0.6) else (0.0,)


def holes(diameter: float, rows: tuple[float, ...], *, x: float) -> Solid:
    """Return the tools of holes along z at ``x``."""
    return total(cylinder(diameter, (-2.0, 3.0)).at(x=x, y=y) for y in rows)


def _upright(diameter: float, rows: tuple[float, ...], *, z: float) -> Solid:
    """Return the tools of holes along x at height ``z``."""
    return total(rod(diameter, (-0.5, y, z), (0.5, y, z)) for y in rows)


def _box_of(x0: float, x1: float, half: float, z: tuple[float, float]) -> Solid:
    return box((min(x0, x1), max(x0, x1)), (-half, half), z)
