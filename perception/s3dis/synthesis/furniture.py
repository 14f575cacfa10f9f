"""Synthetic furniture: each piece stands on z = 0 about the origin, its front towards +y."""

from collections.abc import Sequence

import numpy as np

from perception.s3dis.synthesis.solids import Brush, Cloud, Colour, joined

WOOD: tuple[Colour, ...] = ((150, 105, 65), (190, 150, 105), (95, 65, 45), (215, 205, 190))
CLOTH: tuple[Colour, ...] = ((45, 50, 60), (120, 35, 35), (40, 75, 120), (95, 95, 95), (60, 100, 70))
METAL: Colour = (110, 110, 115)


def chair(brush: Brush) -> Cloud:
    """Return a seat with a back on four legs or on a foot, with or without arms."""
    rng = brush.rng
    side, height, back = rng.uniform(0.40, 0.50), rng.uniform(0.42, 0.50), rng.uniform(0.35, 0.55)
    cloth = _one_of(brush, CLOTH)
    half = side / 2
    parts = [
        brush.box([-half, -half, height - 0.06], [side, side, 0.06], cloth),
        brush.box([-half, -half, height], [side, 0.05, back], cloth),
    ]
    if rng.random() < 0.5:
        parts += _legs(brush, side, side, height - 0.06, 0.03, METAL)
    else:
        parts.append(brush.cylinder([0, 0, 0.08], 0.03, height - 0.14, METAL, cap=False))
        for angle in np.arange(5) * 2 * np.pi / 5:
            tip = [0.3 * np.cos(angle), 0.3 * np.sin(angle), 0]
            parts.append(brush.rectangle([0, 0, 0.06], tip, [-0.15 * tip[1], 0.15 * tip[0], 0], METAL))
    if rng.random() < 0.4:
        for x in (-half, half - 0.05):
            parts.append(brush.box([x, -half, height + 0.18], [0.05, side * 0.8, 0.03], METAL))
    return joined(parts)


def table(brush: Brush, length: float, depth: float) -> Cloud:
    """Return a rectangular top, along x, on four legs or two panels."""
    rng = brush.rng
    height, wood = rng.uniform(0.70, 0.77), _one_of(brush, WOOD)
    top = brush.box([-length / 2, -depth / 2, height - 0.04], [length, depth, 0.04], wood)
    if rng.random() < 0.6:
        return joined([top, *_legs(brush, length, depth, height - 0.04, 0.05, METAL)])
    panels = [
        brush.box([x, -depth / 2 + 0.05, 0], [0.03, depth - 0.1, height - 0.04], wood, ("-x", "+x"))
        for x in (-length / 2 + 0.05, length / 2 - 0.08)
    ]
    return joined([top, *panels])


def round_table(brush: Brush, radius: float) -> Cloud:
    """Return a round top on a column."""
    height, wood = brush.rng.uniform(0.45, 0.75), _one_of(brush, WOOD)
    rim = brush.cylinder([0, 0, height - 0.03], radius, 0.03, wood)
    return joined(
        [rim, brush.cylinder([0, 0, 0], 0.05, height, METAL, cap=False), brush.disc([0, 0, 0.01], 0.2, METAL)]
    )


def sofa(brush: Brush, width: float, depth: float) -> Cloud:
    """Return a seat, a back and two arms, solid down to the floor."""
    cloth, seat = _one_of(brush, CLOTH), brush.rng.uniform(0.38, 0.46)
    half, rear, arm = width / 2, -depth / 2, brush.rng.uniform(0.12, 0.22)
    return joined(
        [
            brush.box([-half + arm, rear + 0.2, 0], [width - 2 * arm, depth - 0.2, seat], cloth, ("+y", "+z")),
            brush.box([-half, rear, 0], [width, 0.2, seat + brush.rng.uniform(0.3, 0.45)], cloth),
            brush.box([-half, rear + 0.2, 0], [arm, depth - 0.2, seat + 0.2], cloth),
            brush.box([half - arm, rear + 0.2, 0], [arm, depth - 0.2, seat + 0.2], cloth),
        ]
    )


def bookcase(brush: Brush, width: float, depth: float, height: float) -> Cloud:
    """Return an open case of shelves, its back to -y."""
    wood, half, rear = _one_of(brush, WOOD), width / 2, -depth / 2
    parts = [
        brush.rectangle([-half, rear + 0.01, 0], [width, 0, 0], [0, 0, height], wood),
        brush.box([-half, rear, 0], [0.025, depth, height], wood, ("-x", "+x", "+y")),
        brush.box([half - 0.025, rear, 0], [0.025, depth, height], wood, ("-x", "+x", "+y")),
    ]
    shelves = np.linspace(0.08, height - 0.025, max(3, int(height / 0.35)) + 1)
    parts += [brush.box([-half, rear, z], [width, depth, 0.025], wood, ("+y", "+z")) for z in shelves]
    return joined(parts)


def books(brush: Brush, width: float) -> Cloud:
    """Return a row of books of one colour, as they stand on a shelf."""
    size = [width, brush.rng.uniform(0.15, 0.22), brush.rng.uniform(0.18, 0.28)]
    return brush.box([-width / 2, -0.1, 0], size, brush.shade_of((120, 90, 80), 50))


def clutter(brush: Brush, screens: bool = False) -> Cloud:
    """Return a box, a bin or, if wanted, a screen on a foot."""
    rng, colour = brush.rng, brush.shade_of((120, 115, 110), 50)
    kind = rng.integers(3 if screens else 2)
    if kind == 0:
        size = rng.uniform([0.15, 0.12, 0.08], [0.4, 0.35, 0.35])
        return brush.box([-size[0] / 2, -size[1] / 2, 0], size.tolist(), colour)
    if kind == 1:
        return brush.cylinder([0, 0, 0], rng.uniform(0.06, 0.16), rng.uniform(0.1, 0.35), colour)
    foot = brush.cylinder([0, -0.02, 0], 0.09, 0.1, METAL)
    return joined([foot, brush.box([-0.26, -0.03, 0.1], [0.52, 0.04, 0.32], (30, 30, 35))])


def lamp(brush: Brush) -> Cloud:
    """Return a lamp that hangs 5 cm below z = 0, the ceiling."""
    size = brush.rng.uniform([0.25, 0.5], [0.4, 1.2])
    low = [-size[0] / 2, -size[1] / 2, -0.05]
    return brush.box(low, [*size.tolist(), 0.05], (245, 245, 235), ("-x", "+x", "-y", "+y", "-z"))


def column(brush: Brush, side: float, height: float, colour: Colour) -> Cloud:
    """Return a square or a round column."""
    if brush.rng.random() < 0.5:
        return brush.cylinder([0, 0, 0], side / 2, height, colour, cap=False)
    return brush.box([-side / 2, -side / 2, 0], [side, side, height], colour, ("-x", "+x", "-y", "+y"))


def _legs(brush: Brush, length: float, depth: float, height: float, side: float, colour: Colour) -> list[Cloud]:
    faces = ("-x", "+x", "-y", "+y")
    return [
        brush.box([x, y, 0], [side, side, height], colour, faces)
        for x in (-length / 2, length / 2 - side)
        for y in (-depth / 2, depth / 2 - side)
    ]


def _one_of(brush: Brush, colours: Sequence[Colour]) -> Colour:
    return brush.shade_of(colours[int(brush.rng.integers(len(colours)))], 12)
