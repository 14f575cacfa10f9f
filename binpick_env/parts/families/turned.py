"""Families of turned parts: shafts, rings and bodies of revolution, with the flats, teeth and keyways that break them.

z lies along the axis of revolution. Lengths are relative; the unit is the part's largest diameter unless noted.
"""

import numpy as np

from binpick_env.parts.families.drawing import (
    ROUND,
    ROUND_BOTH_WAYS,
    Drawing,
    chance,
    cyclic,
    dihedral,
)
from binpick_env.parts.families.solid import (
    FACETS,
    box,
    cylinder,
    prism,
    regular,
    revolved,
    rod,
    total,
    tube,
    turned,
)


def stepped_shaft(rng: np.random.Generator) -> Drawing:
    """Shaft of three to five steps with chamfered ends, the thickest inside; some have a keyway."""
    count = int(rng.integers(3, 6))
    thickest = int(rng.integers(1, count - 1))
    length = rng.uniform(2.2, 4.5)
    shares = rng.uniform(0.5, 1.5, count)
    heights = np.concatenate([[0.0], np.cumsum(shares / shares.sum() * length)])
    falls = rng.uniform(0.12, 0.24, count)
    radii = np.array([0.5 * (1 - falls[min(k, thickest) : max(k, thickest)].sum()) for k in range(count)])
    radii = np.maximum(radii, 0.18)
    radii[0] = min(radii[0], radii[-1] * rng.uniform(0.7, 0.85))  # the ends differ
    chamfer = 0.15 * radii.min()
    outline = [(radii[0] - chamfer, 0.0), (radii[0], chamfer)]
    for k in range(count - 1):
        outline += [(radii[k], heights[k + 1]), (radii[k + 1], heights[k + 1])]
    outline += [(radii[-1], length - chamfer), (radii[-1] - chamfer, length)]
    solid = turned(outline)
    if not chance(rng):
        return Drawing(solid=solid, wall=2 * radii.min(), symmetry=ROUND)
    radius, start, stop = radii[thickest], heights[thickest], heights[thickest + 1]
    margin, width = 0.15 * (stop - start), 0.3 * radius
    key = box((0.72 * radius, 1.2 * radius), (-width, width), (start + margin, stop - margin))
    return Drawing(solid=solid - key, wall=2 * radii.min())


def slender_rod(rng: np.random.Generator) -> Drawing:
    """Long rod with two flats at an end, or at both, and sometimes a cross hole through the flats."""
    length, flat, across = rng.uniform(7.0, 13.0), rng.uniform(0.8, 1.6), rng.uniform(0.5, 0.75)
    both, hole = chance(rng), chance(rng, 0.7)
    angles = 2 * np.pi * np.arange(FACETS) / FACETS
    circle = 0.5 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    section = np.stack([circle[:, 0], np.clip(circle[:, 1], -across / 2, across / 2)], axis=1)
    bar = cylinder(1.0, (-length / 2 + (flat if both else 0.0), length / 2 - flat))
    solid = bar + prism(section, (length / 2 - flat, length / 2))
    solid += prism(section, (-length / 2, flat - length / 2)) if both else cylinder(1.0, (-length / 2, 0.0))
    wall = across
    if hole:
        bore = rng.uniform(0.3, 0.45)
        heights = (length / 2 - flat / 2, flat / 2 - length / 2) if both else (length / 2 - flat / 2,)
        solid -= total(rod(bore, (0, -1, z), (0, 1, z)) for z in heights)
        wall = min(wall, (1 - bore) / 2)
    return Drawing(solid=solid, wall=wall, symmetry=dihedral(2) if both else cyclic(2))


def flanged_bushing(rng: np.random.Generator) -> Drawing:
    """Plain bearing bush with a flange at an end."""
    outer, flange = rng.uniform(0.62, 0.8), rng.uniform(0.07, 0.14)
    inner, height = outer * rng.uniform(0.6, 0.82), rng.uniform(0.45, 1.2)
    solid = tube(1.0, inner, (0.0, flange), sectors=8) + tube(outer, inner, (flange, height), sectors=8)
    return Drawing(solid=solid, wall=min(flange, (outer - inner) / 2), symmetry=ROUND)


def thick_ring(rng: np.random.Generator) -> Drawing:
    """Spacer ring or thick washer with chamfered outer edges."""
    inner, height = rng.uniform(0.4, 0.78), rng.uniform(0.08, 0.35)
    chamfer = min(0.2 * height, 0.15 * (1 - inner))
    section = [
        (inner / 2, -height / 2),
        (0.5 - chamfer, -height / 2),
        (0.5, chamfer - height / 2),
        (0.5, height / 2 - chamfer),
        (0.5 - chamfer, height / 2),
        (inner / 2, height / 2),
    ]
    wall = min(height, (1 - inner) / 2)
    return Drawing(solid=revolved(section, sectors=10), wall=wall, symmetry=ROUND_BOTH_WAYS)


def spool(rng: np.random.Generator) -> Drawing:
    """Core between two equal flanges, with a bore through it."""
    core, flange, height = rng.uniform(0.35, 0.62), rng.uniform(0.08, 0.16), rng.uniform(0.55, 1.3)
    bore = core * rng.uniform(0.35, 0.6)
    z = height / 2
    outline = [
        (0.5, -z),
        (0.5, flange - z),
        (core / 2, flange - z),
        (core / 2, z - flange),
        (0.5, z - flange),
        (0.5, z),
    ]
    solid = turned(outline) - cylinder(bore, (-2.0, 2.0))
    return Drawing(solid=solid, wall=min(flange, (core - bore) / 2), symmetry=ROUND_BOTH_WAYS)


def pulley(rng: np.random.Generator) -> Drawing:
    """V-belt pulley of one to three grooves, with a hub on one side and a bore."""
    grooves, rim = int(rng.integers(1, 4)), rng.uniform(0.03, 0.05)
    pitch, depth = rng.uniform(0.13, 0.18), rng.uniform(0.08, 0.12)
    hub, boss = rng.uniform(0.35, 0.55), rng.uniform(0.12, 0.3)
    outline = [(0.5, 0.0)]
    for k in range(grooves):
        z = k * pitch
        outline += [
            (0.5, z + rim),
            (0.5 - depth, z + 0.42 * pitch + rim / 2),
            (0.5 - depth, z + 0.58 * pitch + rim / 2),
        ]
        outline += [(0.5, (k + 1) * pitch)]
    top = grooves * pitch + rim
    outline += [(0.5, top), (hub / 2, top), (hub / 2, top + boss)]
    bore = hub * rng.uniform(0.4, 0.6)
    solid = turned(outline) - cylinder(bore, (-1.0, 3.0))
    return Drawing(solid=solid, wall=min(rim, (hub - bore) / 2), symmetry=ROUND)


def piston(rng: np.random.Generator) -> Drawing:
    """Engine piston: a crown with ring grooves, a hollow skirt and a bore across for the pin."""
    height, crown, wall = rng.uniform(0.75, 1.15), rng.uniform(0.2, 0.3), rng.uniform(0.07, 0.11)
    pin, grooves = rng.uniform(0.2, 0.28), int(rng.integers(2, 4))
    solid = cylinder(1.0, (height - crown, height)) + tube(1.0, 1 - 2 * wall, (0.0, height - crown), sectors=10)
    for k in range(grooves):
        z = height - 0.06 - k * crown / 3.6
        solid -= tube(1.2, 1 - 0.7 * wall, (z - 0.03, z), sectors=4)
    middle = 0.55 * (height - crown)
    return Drawing(solid=solid - rod(pin, (-1, 0, middle), (1, 0, middle)), wall=0.028, symmetry=cyclic(2))


def hollow_cap(rng: np.random.Generator) -> Drawing:
    """Cup-shaped cap, closed at the top; some have a rim around the mouth."""
    height, wall, rim = rng.uniform(0.35, 1.1), rng.uniform(0.05, 0.1), chance(rng)
    outer = rng.uniform(0.78, 0.9) if rim else 1.0
    roof = wall * rng.uniform(1.0, 1.6)
    chamfer = 0.6 * roof
    top = turned([(outer / 2, height - roof), (outer / 2, height - chamfer), (outer / 2 - chamfer, height)])
    solid = top + tube(outer, outer - 2 * wall, (0.0, height - roof), sectors=8)
    if rim:
        solid += tube(1.0, outer - 2 * wall, (0.0, 1.2 * wall), sectors=8)
    return Drawing(solid=solid, wall=wall, symmetry=ROUND)


def nozzle(rng: np.random.Generator) -> Drawing:
    """Nozzle with a threaded stub, a hexagon for the spanner and a conical tip; bored through."""
    stub, grip = rng.uniform(0.5, 0.75), rng.uniform(0.25, 0.45)
    length, cone, tip = rng.uniform(0.35, 0.7), rng.uniform(0.4, 1.0), rng.uniform(0.25, 0.4)
    bore = tip * rng.uniform(0.35, 0.55)
    solid = cylinder(stub, (-length, 0.0)) + regular(6, 0.95, (0.0, grip))
    solid += cylinder(0.8, (grip, grip + cone), top=tip) - cylinder(bore, (-2.0, 3.0))
    solid -= cylinder(bore, (-2.0, 3.0))
    solid -= cylinder(1.6 * bore, (-length - 1.0, grip))
    return Drawing(solid=solid, wall=min((tip - bore) / 2, (stub - 1.6 * bore) / 2), symmetry=cyclic(6))
