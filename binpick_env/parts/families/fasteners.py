"""Families of fasteners. z lies along the shank or the bore; the unit is the shank's diameter unless noted."""

import numpy as np

from binpick_env.parts.families.drawing import Drawing, cyclic, dihedral
from binpick_env.parts.families.solid import (
    bend,
    cylinder,
    hollow,
    hull_of,
    prism,
    regular,
    turned,
)


def hex_bolt(rng: np.random.Generator) -> Drawing:
    """Hexagon bolt (proportions of ISO 4014): head, washer face and a shank with a chamfered end."""
    across, head, length = rng.uniform(1.45, 1.75), rng.uniform(0.58, 0.75), rng.uniform(2.0, 6.5)
    shank = turned([(0.38, -length), (0.5, 0.12 - length), (0.5, 0.0)])
    solid = shank + cylinder(0.95 * across, (0.0, 0.08)) + regular(6, across, (0.08, head))
    return Drawing(solid=solid, wall=0.5, symmetry=cyclic(6))


def socket_screw(rng: np.random.Generator) -> Drawing:
    """Socket head cap screw (proportions of ISO 4762): a round head with a hexagon socket, a chamfered shank."""
    across, head, length = rng.uniform(1.45, 1.7), rng.uniform(0.9, 1.1), rng.uniform(1.5, 6.0)
    outline = [(0.4, -length), (0.5, 0.1 - length), (0.5, 0.0), (across / 2, 0.0)]
    solid = turned([*outline, (across / 2, head - 0.08), (across / 2 - 0.08, head)])
    socket = rng.uniform(0.75, 0.86)
    solid -= regular(6, socket, (0.5 * head, head + 1.0))
    return Drawing(solid=solid, wall=across / 2 - 0.08 - socket / np.sqrt(3), symmetry=cyclic(6))


def hex_nut(rng: np.random.Generator) -> Drawing:
    """Hexagon nut (proportions of ISO 4032); the unit is the width across flats."""
    bore, height = rng.uniform(0.5, 0.66), rng.uniform(0.35, 0.65)
    z = (-height / 2, height / 2)
    angles = np.pi / 3 * np.arange(7)
    corner = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    outer, inner = corner / np.sqrt(3), 0.99 * bore / 2 * corner
    sides = [prism(np.vstack([outer[k : k + 2], inner[k : k + 2]]), z) for k in range(6)]
    solid = hollow(regular(6, 1.0, z), cylinder(bore, (-1.0, 1.0)), sides)
    return Drawing(solid=solid, wall=(1 - bore) / 2, symmetry=dihedral(6))


def eye_bolt(rng: np.random.Generator) -> Drawing:
    """Lifting eye bolt: a round eye, a collar and a shank; the eye lies in the xz plane."""
    bar, eye, length = rng.uniform(0.6, 0.85), rng.uniform(1.6, 2.4), rng.uniform(1.6, 4.0)
    collar = rng.uniform(1.4, 1.9)
    solid = bend(eye / 2, bar).rotated(x=90.0).at(z=0.3 + eye / 2 + 0.3 * bar)
    solid += cylinder(collar, (0.0, 0.35)) + turned([(0.4, -length), (0.5, 0.1 - length), (0.5, 0.0)])
    return Drawing(solid=solid, wall=0.35, symmetry=cyclic(2))


def wing_nut(rng: np.random.Generator) -> Drawing:
    """Wing nut: a conical hub with a bore and two rising wings along x; the unit is the hub's diameter."""
    height, span, rise = rng.uniform(0.55, 0.85), rng.uniform(1.0, 1.4), rng.uniform(0.9, 1.4)
    tip, thick = rng.uniform(0.45, 0.65), rng.uniform(0.16, 0.24)
    end = cylinder(tip, (-thick / 2, thick / 2)).rotated(x=90.0).at(x=span - tip / 2, z=rise)
    foot = cylinder(0.5 * height, (-thick / 2, thick / 2)).rotated(x=90.0).at(x=0.32, z=0.45 * height)
    solid = cylinder(1.0, (0.0, height), top=0.82) + hull_of(end, foot).repeated(2)
    bore = rng.uniform(0.4, 0.52)
    return Drawing(solid=solid - cylinder(bore, (-1.0, 3.0)), wall=min(thick, 0.41 - bore / 2), symmetry=cyclic(2))
