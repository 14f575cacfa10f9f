"""Families of wheels, knobs, cams and couplings: round parts with teeth, lobes, jaws or spokes around z."""

import numpy as np

from binpick_env.parts.families.drawing import (
    Drawing,
    X,
    chance,
    cyclic,
    dihedral,
)
from binpick_env.parts.families.solid import (
    Solid,
    cylinder,
    hull_of,
    prism,
    revolved,
    rod,
    total,
)


def coupling(rng: np.random.Generator) -> Drawing:
    """Half of a jaw coupling: a hub with two or three jaws on its face and a bore."""
    jaws, hub, height = int(rng.integers(2, 4)), rng.uniform(0.4, 0.8), rng.uniform(0.2, 0.4)
    bore, share = rng.uniform(0.25, 0.4), rng.uniform(0.38, 0.5)
    inner = bore + rng.uniform(0.05, 0.15)
    section = [(inner / 2, hub), (0.5, hub), (0.5, hub + height), (inner / 2, hub + height)]
    jaw = revolved(section, angle=share * 360 / jaws, sectors=3 if jaws == 2 else 2)
    solid = cylinder(1.0, (0.0, hub)) + jaw.repeated(jaws) - cylinder(bore, (-1.0, hub + 1e-6))
    return Drawing(solid=solid, wall=(1 - inner) / 2, symmetry=cyclic(jaws))


def spur_gear(rng: np.random.Generator) -> Drawing:
    """Spur gear of an even number of teeth, with a bore; some have a hub on one side."""
    teeth, width = 2 * int(rng.integers(5, 11)), rng.uniform(0.15, 0.4)
    module = 1.0 / (teeth + 2)
    root, tip = 0.5 - 2.25 * module, 0.5
    # Half widths of a tooth at the root, the pitch circle and the tip; straight flanks in place of involutes.
    flank = [(root - 0.2 * module, 1.1), (root, 1.0), (0.5 - module, 0.78), (tip, 0.42)]
    side = np.array([(radius * np.cos(h * module / radius), h * module) for radius, h in flank])
    half = np.vstack([side, side[::-1] * [1, -1]])
    # A tooth and its opposite are one convex bar through the centre.
    bars = [prism(np.vstack([half, -half]), (0.0, width)).rotated(z=360.0 * k / teeth) for k in range(teeth // 2)]
    solid = cylinder(2 * root, (0.0, width)) + total(bars)
    bore = rng.uniform(0.15, 0.3)
    hub = chance(rng)
    if hub:
        solid += cylinder(min(bore + rng.uniform(0.15, 0.25), 1.8 * root), (0.0, width + rng.uniform(0.1, 0.25)))
    solid -= cylinder(bore, (-1.0, 2.0))
    symmetry = cyclic(teeth) if hub else dihedral(teeth)
    return Drawing(solid=solid, wall=min(width, 0.84 * module, 0.07), symmetry=symmetry)


def star_knob(rng: np.random.Generator) -> Drawing:
    """Clamping knob: three to eight lobes around a disc, a boss below and a blind bore."""
    lobes, height = int(rng.integers(3, 9)), rng.uniform(0.2, 0.35)
    size = {3: 0.34, 4: 0.3, 5: 0.26, 6: 0.22, 7: 0.2, 8: 0.18}[lobes] * rng.uniform(0.9, 1.05)
    lobe = cylinder(size, (0.0, height)).at(x=0.5 - size / 2)
    solid = cylinder(1.0 - 1.1 * size, (0.0, height)) + lobe.repeated(lobes)
    boss, bore = rng.uniform(0.3, 0.4), rng.uniform(0.14, 0.2)
    drop = rng.uniform(0.1, 0.3)
    solid += cylinder(boss, (-drop, 0.0))
    solid -= cylinder(bore, (-1.0, 0.6 * height))
    return Drawing(solid=solid, wall=(boss - bore) / 2, symmetry=cyclic(lobes))


def handwheel(rng: np.random.Generator) -> Drawing:
    """Handwheel: a round rim, three to five spokes and a longer hub with a bore."""
    spokes, rim = int(rng.integers(3, 6)), rng.uniform(0.07, 0.11)
    hub, height = rng.uniform(0.2, 0.28), rng.uniform(0.16, 0.3)
    turns = 2 * np.pi * np.arange(24) / 24
    section = np.stack([0.5 - rim / 2 + rim / 2 * np.cos(turns), rim / 2 * np.sin(turns)], axis=1)
    spoke = rod(0.7 * rim, (0.35 * hub, 0.0, 0.0), (0.5 - rim / 2, 0.0, 0.0))
    solid: Solid = revolved(section, sectors=10) + spoke.repeated(spokes) + cylinder(hub, (-0.3 * height, 0.7 * height))
    bore = hub * rng.uniform(0.4, 0.55)
    solid -= cylinder(bore, (-1.0, 1.0))
    return Drawing(solid=solid, wall=min(0.7 * rim, (hub - bore) / 2), symmetry=cyclic(spokes))


def cam(rng: np.random.Generator) -> Drawing:
    """Disc cam: a base circle, a nose and a bore; some have a hub on one side."""
    nose, lift, width = rng.uniform(0.3, 0.6), rng.uniform(0.3, 0.6), rng.uniform(0.15, 0.4)
    from_base, hub = cylinder(1.0, (-width / 2, width / 2)), chance(rng)
    lobe = cylinder(nose, (-width / 2, width / 2)).at(x=0.5 + lift - nose / 2)
    solid, bore = hull_of(from_base, lobe), rng.uniform(0.25, 0.4)
    if hub:
        solid += cylinder(bore + rng.uniform(0.2, 0.3), (0.0, width / 2 + rng.uniform(0.15, 0.35)))
    solid -= cylinder(bore, (-1.0, 2.0))
    return Drawing(solid=solid, wall=min(width, 0.1), symmetry=cyclic(1) if hub else cyclic(2, X))
