"""Families of pipe fittings. The unit is the pipe's outer diameter; bores are ignored by the pieces."""

import numpy as np

from binpick_env.parts.families.drawing import ROUND, Drawing, Y, chance, cyclic, dihedral
from binpick_env.parts.families.solid import OVERLAP, Solid, bend, cylinder, regular, rod, total, turned


def pipe_elbow(rng: np.random.Generator) -> Drawing:
    """Elbow of 45 or 90 degrees with a collar at each mouth; it bends about z."""
    angle, radius = (90.0, 45.0)[int(rng.integers(2))], rng.uniform(0.75, 1.5)
    collar, depth, bore = rng.uniform(1.15, 1.35), rng.uniform(0.3, 0.6), rng.uniform(0.65, 0.82)
    mouth = _socket(collar, depth).rotated(x=90.0).at(x=radius)  # leaves along -y, where the bend begins
    hole = cylinder(bore, (-0.01, depth + 1.0)).rotated(x=90.0).at(x=radius)
    other, other_hole = (each.rotated(z=-angle).mirrored((0, 1, 0)) for each in (mouth, hole))
    solid = bend(radius, 1.0, angle=angle, sectors=4) + mouth + other
    solid = solid - bend(radius, bore, angle=angle, sectors=2) - hole - other_hole
    half = np.deg2rad(angle / 2)
    return Drawing(solid=solid, wall=(1 - bore) / 2, symmetry=cyclic(2, np.array([np.cos(half), np.sin(half), 0.0])))


def tee_fitting(rng: np.random.Generator) -> Drawing:
    """Tee with equal or smaller branch and a collar at each mouth; the run lies along x, the branch along z."""
    run, branch, small = rng.uniform(0.9, 1.6), rng.uniform(0.95, 1.7), rng.uniform(0.7, 1.0)
    collar, depth, bore = rng.uniform(1.12, 1.35), rng.uniform(0.25, 0.45), rng.uniform(0.65, 0.82)
    leg = cylinder(small, (0.0, branch)) + cylinder(collar * small, (branch - depth, branch))
    solid = (
        _run(run, run, collar, depth).rotated(y=90.0)
        + leg
        - rod(bore, (-3, 0, 0), (3, 0, 0))
        - cylinder(bore * small, (0.0, 3.0))
    )
    return Drawing(solid=solid, wall=small * (1 - bore) / 2, symmetry=cyclic(2))


def cross_fitting(rng: np.random.Generator) -> Drawing:
    """Cross of two pipes along x and z with a collar at each mouth; half of them have four equal arms."""
    long, equal = rng.uniform(0.9, 1.5), chance(rng)
    short = long if equal else long * rng.uniform(0.7, 0.85)
    collar, depth, bore = rng.uniform(1.12, 1.35), rng.uniform(0.2, 0.35), rng.uniform(0.65, 0.82)
    solid = _run(long, long, collar, depth).rotated(y=90.0) + _run(short, short, collar, depth)
    solid = solid - rod(bore, (-3, 0, 0), (3, 0, 0)) - rod(bore, (0, 0, -3), (0, 0, 3))
    return Drawing(solid=solid, wall=(1 - bore) / 2, symmetry=dihedral(4 if equal else 2, axis=Y))


def y_fitting(rng: np.random.Generator) -> Drawing:
    """Lateral: a run along z and a branch that leaves it at 45 to 60 degrees, a collar at each mouth."""
    angle, below, above = rng.uniform(45.0, 60.0), rng.uniform(0.6, 1.0), rng.uniform(1.5, 2.0)
    collar, depth, bore = rng.uniform(1.12, 1.3), rng.uniform(0.25, 0.4), rng.uniform(0.65, 0.82)
    branch = _arm(rng.uniform(1.6, 2.2), collar, depth).rotated(y=angle)
    solid = _run(below, above, collar, depth) + branch
    solid = solid - cylinder(bore, (-3.0, 3.0)) - cylinder(bore, (0.0, 4.0)).rotated(y=angle)
    return Drawing(solid=solid, wall=(1 - bore) / 2)


def reducer(rng: np.random.Generator) -> Drawing:
    """Concentric reducer: a wide pipe, a cone and a narrow pipe, with an even wall."""
    small, cone = rng.uniform(0.4, 0.75), rng.uniform(0.3, 0.8)
    wide, narrow, wall = rng.uniform(0.2, 0.6), rng.uniform(0.2, 0.7), rng.uniform(0.06, 0.1)
    outline = [(0.5, 0.0), (0.5, wide), (small / 2, wide + cone), (small / 2, wide + cone + narrow)]
    if chance(rng):
        outline = [(0.58, 0.0), (0.58, 0.15), (0.5, 0.15), *outline[1:]]
    inside = [(0.5 - wall, -1.0), (0.5 - wall, wide), (small / 2 - wall, wide + cone), (small / 2 - wall, 4.0)]
    return Drawing(solid=turned(outline) - turned(inside), wall=0.85 * wall, symmetry=ROUND)


def pipe_flange(rng: np.random.Generator) -> Drawing:
    """Welding-neck flange: a disc with four, six or eight bolt holes, a conical neck and a bore."""
    holes, disc, neck = int(rng.choice([4, 6, 8])), rng.uniform(0.2, 0.35), rng.uniform(0.4, 0.9)
    size = rng.uniform(1.8, 2.3)
    foot, bore = rng.uniform(1.12, 1.3), rng.uniform(0.65, 0.8)
    outline = [(size / 2, 0.0), (size / 2, disc), (foot / 2, disc), (0.5, disc + 0.7 * neck), (0.5, disc + neck)]
    bolt = rng.uniform(0.18, 0.26)
    circle = (size + foot) / 4
    solid = turned(outline) - cylinder(bore, (-1.0, 4.0)) - cylinder(bolt, (-1.0, 2.0)).at(x=circle).repeated(holes)
    wall = min((1 - bore) / 2, size / 2 - circle - bolt / 2, disc)
    return Drawing(solid=solid, wall=wall, symmetry=cyclic(holes))


def hose_barb(rng: np.random.Generator) -> Drawing:
    """Hose connector: a threaded end, a hexagon and two to four barbs; bored through."""
    barbs, across, grip = int(rng.integers(2, 5)), rng.uniform(1.3, 1.6), rng.uniform(0.35, 0.5)
    pitch, thread, bore = rng.uniform(0.4, 0.55), rng.uniform(0.7, 1.1), rng.uniform(0.45, 0.6)
    outline: list[tuple[float, float]] = [(0.4, grip), (0.4, grip + 0.3)]
    for k in range(barbs):
        foot, top = grip + 0.3 + k * pitch, grip + 0.3 + (k + 1) * pitch
        outline += [(0.5, foot), (0.4, top)]
    solid: Solid = total([cylinder(1.1, (-thread, 0.0)), regular(6, across, (0.0, grip)), turned(outline)])
    return Drawing(solid=solid - cylinder(bore, (-3.0, 6.0)), wall=0.4 - bore / 2, symmetry=cyclic(6))


def _socket(collar: float, depth: float) -> Solid:
    """Return a collar from the origin to ``depth`` along z; it reaches a little back into the bend."""
    return cylinder(collar, (-OVERLAP, depth))


def _run(below: float, above: float, collar: float, depth: float) -> Solid:
    """Return a pipe of diameter 1 along z from ``-below`` to ``above``, with a collar at each end."""
    ends = ((-below, depth - below), (above - depth, above))
    return total([cylinder(1.0, (-below, above)), *(cylinder(collar, end) for end in ends)])


def _arm(length: float, collar: float, depth: float) -> Solid:
    """Return a pipe of diameter 1 from the origin along z, with a collar at its end."""
    return cylinder(1.0, (0.0, length)) + cylinder(collar, (length - depth, length))
