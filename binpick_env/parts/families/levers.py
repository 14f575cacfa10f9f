"""Families of levers, rods and spanners. z lies along the thickness; the unit is the length along x."""

import numpy as np

from binpick_env.parts.families.drawing import Drawing, X, cyclic
from binpick_env.parts.families.solid import Solid, box, cylinder, hull_of, prism, total, tube


def connecting_rod(rng: np.random.Generator) -> Drawing:
    """Connecting rod: a large open ring, a small eye and a tapered beam with a pocket on both faces; x along it."""
    big, small = rng.uniform(0.32, 0.42), rng.uniform(0.2, 0.28)
    bores = big * rng.uniform(0.62, 0.72), small * rng.uniform(0.45, 0.6)
    thick, beam = rng.uniform(0.12, 0.18), rng.uniform(0.55, 0.8)
    h, b = thick / 2, thick * beam / 2
    x0, x1 = big / 2, 1 - small / 2
    solid = tube(big, bores[0], (-h, h), sectors=8).at(x=x0) + cylinder(small, (-h, h)).at(x=x1)
    start, stop = x0 + (big + bores[0]) / 4, x1 - (small + bores[1]) / 4
    bar = hull_of(
        box((start, start + 0.01), (-0.28 * big, 0.28 * big), (-b, b)),
        box((stop - 0.01, stop), (-0.28 * small, 0.28 * small), (-b, b)),
    )
    solid = solid + bar - cylinder(bores[1], (-1.0, 1.0)).at(x=x1)
    pocket = hull_of(
        box((start + 0.09, start + 0.1), (-0.14 * big, 0.14 * big), (0.4 * b, 1.0)),
        box((stop - 0.08, stop - 0.07), (-0.12 * small, 0.12 * small), (0.4 * b, 1.0)),
    )
    solid = solid - pocket - pocket.mirrored((0, 0, 1))
    return Drawing(solid=solid, wall=min((big - bores[0]) / 2, 0.8 * b, 0.1 * small), symmetry=cyclic(2, X))


def rocker_lever(rng: np.random.Generator) -> Drawing:
    """Bell crank: two unequal arms at an angle from a thick hub to an eye each."""
    angle, short = rng.uniform(75.0, 160.0), rng.uniform(0.55, 0.8)
    hub, eye, thick = rng.uniform(0.26, 0.36), rng.uniform(0.17, 0.24), rng.uniform(0.07, 0.12)
    h = thick / 2
    solid = cylinder(hub, (-thick, thick))
    tools = [cylinder(hub * rng.uniform(0.4, 0.55), (-1.0, 1.0))]
    for length, turn in ((0.8, 0.0), (0.8 * short, angle)):
        narrow = box((0.25 * hub, 0.3 * hub), (-0.3 * hub, 0.3 * hub), (-0.8 * h, 0.8 * h))
        arm = hull_of(
            narrow, box((length - 0.3 * eye, length - 0.25 * eye), (-0.3 * eye, 0.3 * eye), (-0.8 * h, 0.8 * h))
        )
        solid = solid + (arm + cylinder(eye, (-h, h)).at(x=length)).rotated(z=turn)
        tools.append(cylinder(0.5 * eye, (-1.0, 1.0)).at(x=length).rotated(z=turn))
    return Drawing(solid=solid - total(tools), wall=min(0.8 * thick, eye / 4, hub * 0.22))


def crank_arm(rng: np.random.Generator) -> Drawing:
    """Crank: a tapered arm, a bored hub on one side and a handle pin on the other."""
    hub, end, thick = rng.uniform(0.26, 0.36), rng.uniform(0.16, 0.24), rng.uniform(0.08, 0.13)
    pin, boss = rng.uniform(0.25, 0.6), rng.uniform(0.08, 0.2)
    grip = end * rng.uniform(0.55, 0.85)
    x0, x1 = hub / 2, 1 - end / 2
    solid: Solid = hull_of(cylinder(hub, (0.0, thick)).at(x=x0), cylinder(end, (0.0, thick)).at(x=x1))
    solid = solid + cylinder(0.9 * hub, (-boss, 0.01)).at(x=x0) + cylinder(grip, (thick / 2, thick + pin)).at(x=x1)
    bore = hub * rng.uniform(0.4, 0.55)
    return Drawing(solid=solid - cylinder(bore, (-1.0, 1.0)).at(x=x0), wall=min(thick, 0.45 * hub - bore / 2))


def spanner(rng: np.random.Generator) -> Drawing:
    """Double open-ended spanner: two jaws of different sizes, inclined by 15 degrees, and a flat handle along x."""
    big, thick = rng.uniform(0.28, 0.36), rng.uniform(0.045, 0.075)
    small, neck = big * rng.uniform(0.7, 0.85), rng.uniform(0.3, 0.42)
    z = (-0.4 * thick, 0.4 * thick)
    x0, x1 = 0.75 * big - 0.5, 0.5 - 0.75 * small
    handle = hull_of(
        box((x0, x0 + 0.01), (-neck * big / 2, neck * big / 2), z),
        box((x1 - 0.01, x1), (-neck * small / 2, neck * small / 2), z),
    )
    solid = handle + _jaw(small, thick).at(x=0.5 - small / 2) + _jaw(big, thick).rotated(z=180.0).at(x=big / 2 - 0.5)
    return Drawing(solid=solid, wall=min(0.8 * thick, 0.2 * small))


def _jaw(size: float, thick: float) -> Solid:
    """Return an open jaw of diameter ``size`` about the origin that opens along x, inclined by 15 degrees."""
    turns = np.deg2rad(np.linspace(105.0, 255.0, 13))
    arc = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    back = np.vstack([arc, [(-0.1, -0.95), (-0.1, 0.95)]])
    upper = np.array([(-0.15, 0.5), (-0.3, 0.95), (0.3, 0.98), (0.95, 0.75), (1.0, 0.5)])
    outlines = (back, upper, upper * [1, -1])
    return total(prism(size / 2 * each, (-thick / 2, thick / 2)) for each in outlines).rotated(z=15.0)
