"""Families of blocks: machined solids and a heat sink. z points up; the unit is the longer side of the section."""

import numpy as np

from binpick_env.parts.families.drawing import Drawing, chance, cyclic
from binpick_env.parts.families.profiles import holes, rectangle
from binpick_env.parts.families.solid import box, cylinder, profile, rod, total


def v_block(rng: np.random.Generator) -> Drawing:
    """V-block: a block with a right-angled groove along its top, a relief slot below it and slots in its sides."""
    height, width, half = rng.uniform(0.6, 0.95), rng.uniform(0.5, 1.3), rng.uniform(0.28, 0.4)
    floor = height - half
    sides = [[(0.5, 0.0), (0.5, height), (half, height), (0.0, floor), (0.0, 0.0)]]
    sides.append([(-x, z) for x, z in sides[0]])
    solid, slot = profile(*sides, width=width), rng.uniform(0.06, 0.1)
    solid -= box((-slot / 2, slot / 2), (-2, 2), (floor - slot, height))
    if chance(rng):
        z = (0.35 * height, 0.35 * height + 1.5 * slot)
        solid = solid - box((0.5 - slot, 1.0), (-2, 2), z) - box((-1.0, slot - 0.5), (-2, 2), z)
    return Drawing(solid=solid, wall=0.1, symmetry=cyclic(2))


def dovetail(rng: np.random.Generator) -> Drawing:
    """Dovetail slide: a base plate and a dovetail rail on it, with countersunk holes."""
    base, rail, width = rng.uniform(0.15, 0.3), rng.uniform(0.15, 0.3), rng.uniform(0.5, 1.8)
    top = rng.uniform(0.55, 0.8)
    neck = top / 2 - 0.55 * rail
    tail = [(-neck, base), (neck, base), (top / 2, base + rail), (-top / 2, base + rail)]
    solid = profile(rectangle(-0.5, 0.5, 0, base), tail, width=width)
    hole = min(0.18, 1.1 * neck)
    rows = (-0.3 * width, 0.3 * width) if width > 0.8 else (0.0,)
    solid = solid - holes(0.6 * hole, rows, x=0.0)
    solid -= total(cylinder(hole, (base + 0.5 * rail, 2.0)).at(y=y) for y in rows)
    return Drawing(solid=solid, wall=min(base, neck - hole / 2 + 0.05), symmetry=cyclic(2))


def heat_sink(rng: np.random.Generator) -> Drawing:
    """Heat sink: a base with five to nine equal fins along y."""
    fins, height, width = int(rng.integers(5, 10)), rng.uniform(0.3, 0.7), rng.uniform(0.6, 1.4)
    base, share = rng.uniform(0.07, 0.12), rng.uniform(0.35, 0.5)
    pitch = 1.0 / (fins - 1 + share)
    wall = share * pitch
    starts = -0.5 + pitch * np.arange(fins)
    solid = profile(
        rectangle(-0.5, 0.5, 0, base), *(rectangle(x, x + wall, base / 2, height) for x in starts), width=width
    )
    return Drawing(solid=solid, wall=min(wall, base), symmetry=cyclic(2))


def wedge(rng: np.random.Generator) -> Drawing:
    """Wedge with a blunt nose; some have a hole from the back along x, others one from the top."""
    height, nose, width = rng.uniform(0.25, 0.5), rng.uniform(0.05, 0.1), rng.uniform(0.25, 0.7)
    solid = profile([(0.0, 0.0), (1.0, 0.0), (1.0, height), (0.0, nose)], width=width)
    hole = rng.uniform(0.3, 0.5) * min(height, width)
    if chance(rng):
        solid -= rod(hole, (0.4, 0.0, 0.45 * height), (2.0, 0.0, 0.45 * height))
    else:
        solid -= holes(hole, (0.0,), x=0.7)
    return Drawing(solid=solid, wall=nose)


def manifold_block(rng: np.random.Generator) -> Drawing:
    """Hydraulic manifold: a block with a row of ports on top, one in an end and mounting holes; some have a stub."""
    width, height, ports = rng.uniform(0.35, 0.55), rng.uniform(0.3, 0.5), int(rng.integers(2, 5))
    port = min(0.5 / ports, 0.4 * width)
    solid = box((-0.5, 0.5), (-width / 2, width / 2), (0.0, height))
    if chance(rng):
        solid += cylinder(0.55 * width, (height, height + rng.uniform(0.15, 0.3))).at(x=-0.3, y=0.0)
    solid -= total(cylinder(port, (0.45 * height, 2.0)).at(x=x, y=0.06 * width) for x in np.linspace(-0.3, 0.38, ports))
    solid -= rod(0.4 * height, (0.2, 0.0, 0.3 * height), (1.0, 0.0, 0.3 * height))
    mount = 0.12 * width
    solid -= total(rod(mount, (x, -1, 0.82 * height), (x, 1, 0.82 * height)) for x in (-0.44, 0.45))
    return Drawing(solid=solid, wall=min(0.45 * width - port / 2, 0.04))
