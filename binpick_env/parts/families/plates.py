"""Families of flat parts: plates, levers and rods. z lies along the thickness; the unit is the longer side."""

import numpy as np

from binpick_env.parts.families.drawing import Drawing, chance, cyclic, dihedral
from binpick_env.parts.families.solid import Solid, box, cylinder, hull_of, plate, rod, total


def drilled_plate(rng: np.random.Generator) -> Drawing:
    """Plate with rounded corners and a hole in each, sometimes a large one in the middle or one more off the axes."""
    width, thick = rng.uniform(0.4, 0.85), rng.uniform(0.05, 0.16)
    corner, hole = rng.uniform(0.04, 0.12), rng.uniform(0.06, 0.1)
    half, inset = thick / 2, rng.uniform(0.09, 0.12)
    solid = plate(1.0, width, (-half, half), corner)
    x, y = 0.5 - inset, width / 2 - inset
    solid -= total(cylinder(hole, (-1.0, 1.0)).at(sx * x, sy * y) for sx in (-1, 1) for sy in (-1, 1))
    if chance(rng):
        solid -= cylinder(rng.uniform(0.2, 0.35) * width, (-1.0, 1.0))
    extra = chance(rng, 0.4)
    if extra:
        solid -= cylinder(1.3 * hole, (-1.0, 1.0)).at(0.28, 0.18 * width)
    return Drawing(solid=solid, wall=min(thick, inset - hole / 2), symmetry=cyclic(1) if extra else dihedral(2))


def pocketed_plate(rng: np.random.Generator) -> Drawing:
    """Plate with one pocket, or with two equal ones and a web between, milled into its top; a hole in each corner."""
    width, thick, wall = rng.uniform(0.5, 0.85), rng.uniform(0.12, 0.25), rng.uniform(0.1, 0.14)
    floor, web = thick * rng.uniform(0.25, 0.45), rng.uniform(0.05, 0.09)
    solid = plate(1.0, width, (0.0, floor)) + frame(1.0, width, wall, (floor, thick))
    if chance(rng):
        solid += box((-web / 2, web / 2), (wall / 2 - width / 2, width / 2 - wall / 2), (floor / 2, thick))
    hole, inset = 0.45 * wall, 0.55 * wall
    x, y = 0.5 - inset, width / 2 - inset
    solid -= total(cylinder(hole, (-1.0, 1.0)).at(sx * x, sy * y) for sx in (-1, 1) for sy in (-1, 1))
    return Drawing(solid=solid, wall=min(floor, web, inset - hole / 2), symmetry=cyclic(2))


def hinge_leaf(rng: np.random.Generator) -> Drawing:
    """Leaf of a butt hinge: a plate with holes and two or three knuckles on one edge, bored for the pin."""
    width, thick = rng.uniform(0.4, 0.75), rng.uniform(0.05, 0.08)
    barrel, knuckles = thick * rng.uniform(2.2, 2.8), int(rng.integers(2, 4))
    pin, hole = 0.5 * barrel, rng.uniform(0.08, 0.12)
    step = 1.0 / (2 * knuckles - 1)
    leaf = box((-0.5, 0.5), (barrel / 2 + 0.02, width), (0.0, thick))
    solid = leaf
    for k in range(knuckles):
        x = -0.5 + 2 * k * step
        solid += rod(barrel, (x, 0.0, barrel / 2), (x + step, 0.0, barrel / 2))
        solid += box((x, x + step), (0.0, barrel / 2 + 0.03), (0.0, thick))
    solid -= rod(pin, (-1.0, 0.0, barrel / 2), (1.0, 0.0, barrel / 2))
    places = ((-0.32, 0.7 * width), (0.0, 0.45 * width), (0.32, 0.7 * width))
    solid -= total(cylinder(hole, (-1.0, 1.0)).at(x, y) for x, y in places)
    return Drawing(solid=solid, wall=min(thick, (barrel - pin) / 2))


def oval_flange(rng: np.random.Generator) -> Drawing:
    """Two-bolt flange: an oval plate with a bore and two holes along x; some have a neck."""
    thick, middle, end = rng.uniform(0.1, 0.2), rng.uniform(0.45, 0.65), rng.uniform(0.22, 0.3)
    z, neck, hole = (-thick / 2, thick / 2), chance(rng), rng.uniform(0.09, 0.13)
    ears = [cylinder(end, z).at(x=s * (0.5 - end / 2)) for s in (-1, 1)]
    solid, bore = hull_of(cylinder(middle, z), *ears), middle * rng.uniform(0.4, 0.6)
    if neck:
        outer = min(bore + rng.uniform(0.1, 0.15), 0.95 * middle)
        solid += cylinder(outer, (0.0, thick / 2 + rng.uniform(0.1, 0.3)))
    solid = (
        solid - cylinder(bore, (-1.0, 1.0)) - total(cylinder(hole, (-1, 1)).at(x=s * (0.5 - end / 2)) for s in (-1, 1))
    )
    return Drawing(solid=solid, wall=min(0.05, thick), symmetry=cyclic(2) if neck else dihedral(2))


def frame(length: float, width: float, wall: float, z: tuple[float, float]) -> Solid:
    """Return four walls around a rectangular opening, centred on the z axis."""
    x, y = length / 2, width / 2
    walls = [box((-x, x), (y - wall, y), z), box((-x, x), (-y, wall - y), z)]
    inner = wall - y, y - wall
    walls += [box((x - wall, x), inner, z), box((-x, wall - x), inner, z)]
    return total(walls)
