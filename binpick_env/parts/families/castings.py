"""Families of castings and machined blocks. z points up from the mounting face; the unit is the longest side."""

import numpy as np

from binpick_env.parts.families.drawing import Drawing, chance, cyclic
from binpick_env.parts.families.plates import frame
from binpick_env.parts.families.solid import (
    OVERLAP,
    Solid,
    bend,
    box,
    cylinder,
    hull_of,
    plate,
    rod,
    total,
)


def housing(rng: np.random.Generator) -> Drawing:
    """Open housing with a flange around its mouth, a hole in each of its corners; some have a port in one side."""
    width, height, wall = rng.uniform(0.55, 0.85), rng.uniform(0.3, 0.6), rng.uniform(0.05, 0.08)
    lip, thick = rng.uniform(0.09, 0.13), rng.uniform(0.06, 0.1)
    length, depth = 1.0 - 2 * lip, width - 2 * lip
    solid = plate(length, depth, (0.0, wall)) + frame(length, depth, wall, (wall, height))
    solid += frame(1.0, width, lip + wall, (height - thick, height))
    hole, inset = 0.5 * lip, 0.55 * lip
    x, y = 0.5 - inset, width / 2 - inset
    solid -= total(cylinder(hole, (0.0, 2.0)).at(sx * x, sy * y) for sx in (-1, 1) for sy in (-1, 1))
    port = chance(rng)
    if port:
        z = (height - thick) * 0.55
        solid -= rod(0.5 * (height - thick), (0.0, 0.0, z), (1.0, 0.0, z))
    return Drawing(solid=solid, wall=min(wall, inset - hole / 2), symmetry=cyclic(1) if port else cyclic(2))


def pillow_block(rng: np.random.Generator) -> Drawing:
    """Pillow block bearing: a foot with a hole at each end and an arch around a bore along y."""
    foot, width, arch = rng.uniform(0.1, 0.18), rng.uniform(0.2, 0.35), rng.uniform(0.42, 0.55)
    axis = foot + arch * rng.uniform(0.45, 0.65)
    thick, hole = width * rng.uniform(0.6, 0.9), rng.uniform(0.08, 0.12)
    ring = cylinder(arch, (-thick / 2, thick / 2)).rotated(x=90.0).at(z=axis)
    body = hull_of(ring, box((-0.55 * arch, 0.55 * arch), (-thick / 2, thick / 2), (foot / 2, foot)))
    bore = arch * rng.uniform(0.45, 0.65)
    solid = plate(1.0, width, (0.0, foot), 0.15 * width) + body - rod(bore, (0, -1, axis), (0, 1, axis))
    solid -= total(cylinder(hole, (-1.0, 1.0)).at(x=s * 0.4) for s in (-1, 1))
    return Drawing(solid=solid, wall=min(foot, (arch - bore) / 2, 0.1 - hole / 2), symmetry=cyclic(2))


def clevis(rng: np.random.Generator) -> Drawing:
    """Fork head: two rounded tines with a bore across, a base and a shank along z."""
    width, tine = rng.uniform(0.34, 0.48), rng.uniform(0.08, 0.12)
    base, shank = rng.uniform(0.1, 0.18), rng.uniform(0.18, 0.35)
    length = 1.0 - base - shank
    gap = width * rng.uniform(0.8, 1.1)
    outer = gap / 2 + tine
    solid = box((-outer, outer), (-width / 2, width / 2), (0.0, base))
    solid += cylinder(rng.uniform(0.6, 0.85) * width, (-shank, 0.01))
    for side in (-1, 1):
        x = (min(side * gap / 2, side * outer), max(side * gap / 2, side * outer))
        end = cylinder(width, x).rotated(y=90.0).at(z=base + length - width / 2)
        solid += hull_of(box(x, (-width / 2, width / 2), (base / 2, base)), end)
    z = base + length - width / 2
    bore = width * rng.uniform(0.4, 0.55)
    return Drawing(
        solid=solid - rod(bore, (-1, 0, z), (1, 0, z)), wall=min(tine, (width - bore) / 2), symmetry=cyclic(2)
    )


def corner_bracket(rng: np.random.Generator) -> Drawing:
    """Corner cube: three plates that meet at right angles, equal or not, with a hole in each."""
    wall, equal = rng.uniform(0.08, 0.16), chance(rng)
    y, z = (1.0, 1.0) if equal else (rng.uniform(0.78, 0.9), rng.uniform(0.55, 0.7))
    solid = box((0.0, 1.0), (0.0, y), (0.0, wall))
    solid += box((0.0, 1.0), (0.0, wall), (wall, z))
    solid += box((0.0, wall), (wall, y), (wall, z))
    hole = rng.uniform(0.15, 0.3)
    a, b, c = 0.55, 0.55 * y, 0.58 * z
    if equal:
        b = c = a
    tools = [
        cylinder(hole, (-1.0, 0.5)).at(a, b),
        rod(hole, (a, -1, c), (a, 0.5, c)),
        rod(hole, (-1, b, c), (0.5, b, c)),
    ]
    return Drawing(solid=solid - total(tools), wall=wall, symmetry=cyclic(3, np.ones(3)) if equal else cyclic(1))


def handle(rng: np.random.Generator) -> Drawing:
    """Bow handle: a round grip along x, two bends and legs, and a flat foot with a hole under each leg."""
    bar, height, radius = rng.uniform(0.08, 0.13), rng.uniform(0.22, 0.38), rng.uniform(0.09, 0.15)
    foot, thick = bar * rng.uniform(1.7, 2.3), rng.uniform(0.05, 0.09)
    inset = rng.uniform(0.6, 0.8) * foot
    leg = 0.5 - inset
    solid: Solid = rod(bar, (radius - leg - OVERLAP, 0.0, height), (leg - radius + OVERLAP, 0.0, height))
    corner = bend(radius, bar, angle=90.0, sectors=2).rotated(x=90.0)
    side = corner.at(x=leg - radius, z=height - radius) + cylinder(bar, (thick / 2, height - radius + OVERLAP)).at(
        x=leg
    )
    hole = 0.4 * (foot - bar) + 0.02
    side += hull_of(
        box((leg - 0.6 * bar, leg), (-foot / 2, foot / 2), (0.0, thick)),
        cylinder(foot, (0.0, thick)).at(x=0.5 - foot / 2),
    )
    side -= cylinder(min(hole, 0.06), (-1.0, thick + 0.01)).at(x=0.5 - 0.25 * foot)
    return Drawing(solid=solid + side + side.rotated(z=180.0), wall=min(bar, thick, 0.04), symmetry=cyclic(2))


def hook(rng: np.random.Generator) -> Drawing:
    """Crane hook: a collar and a shank along z, a bow of 200 to 235 degrees in the xz plane and a tapered tip."""
    bar, radius = rng.uniform(0.12, 0.17), rng.uniform(0.2, 0.26)
    angle, shank = rng.uniform(200.0, 235.0), rng.uniform(0.25, 0.45)
    bow = bend(radius, bar, angle=angle, sectors=6).rotated(x=90.0).mirrored((0, 0, 1))
    end = np.deg2rad(angle)
    start = np.array([radius * np.cos(end), 0.0, -radius * np.sin(end)])
    along = np.array([-np.sin(end), 0.0, -np.cos(end)])
    tip = start + along * rng.uniform(0.08, 0.16)
    point = rod(0.5 * bar, tip - 0.02 * along, tip)
    solid = bow + cylinder(bar, (-OVERLAP, shank)).at(x=radius)
    solid += hull_of(rod(bar, start - OVERLAP * along, start), point)
    collar = rng.uniform(1.4, 1.9) * bar
    solid += cylinder(collar, (0.55 * shank, 0.55 * shank + 0.4 * bar)).at(x=radius)
    return Drawing(solid=solid, wall=0.4 * bar)
