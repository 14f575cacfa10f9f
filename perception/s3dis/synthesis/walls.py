"""Walls of a synthetic room with their doors, windows and furniture.

In the frame of a wall, x points along the wall, y into the room and z up.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from perception.geometry import Floats
from perception.s3dis.synthesis import furniture
from perception.s3dis.synthesis.interior import Interior, Item
from perception.s3dis.synthesis.solids import Cloud, Hole, joined, moved

ALONG = ("door", "window", "board", "bookcase", "sofa", "column")


def build_walls(interior: Interior, chances: Sequence[float]) -> None:
    """Add four walls, one of them with a door.

    Args:
        interior: Room to add the walls to.
        chances: Mean number per metre of wall of each of ``ALONG``.
    """
    width, depth, height = interior.size
    corners = [(0.0, 0.0, 0.0), (width, 0.0, np.pi / 2), (width, depth, np.pi), (0.0, depth, -np.pi / 2)]
    for side, (x, y, yaw) in enumerate(corners):
        length = depth if side % 2 else width
        items, holes = [], list[Hole]()
        for thing, at in _slots(chances, length, interior.brush.rng, door=side == 0):
            made = _MAKERS[thing](interior, at)
            if _blocks(interior, thing, made, x, y, yaw):
                continue
            items.append(Item(thing, made.cloud))
            items += made.extras
            holes.append(made.hole)
        paint = interior.brush.shade_of(interior.paint, 4)
        wall = interior.brush.pierced([0, 0, 0], [length, 0, 0], [0, 0, height], paint, holes)
        for category, cloud in [Item("wall", wall), *items]:
            interior.put(category, cloud, x, y, yaw=yaw)


def _slots(chances: Sequence[float], length: float, rng: np.random.Generator, door: bool) -> list[tuple[str, float]]:
    """Return objects of ``ALONG`` and the positions of their centres along a wall [m], without overlap."""
    wanted = [thing for thing, mean in zip(ALONG, chances, strict=True) for _ in range(rng.poisson(mean * length))]
    wanted = [wanted[k] for k in rng.permutation(len(wanted))]
    found: list[tuple[str, float]] = []
    for thing in ["door", *wanted] if door else wanted:
        room = 0.5 * _WIDTHS[thing] + 0.05
        if length <= 2 * room:
            continue
        at = rng.uniform(room, length - room)
        if all(abs(at - other) > room + 0.5 * _WIDTHS[name] for name, other in found):
            found.append((thing, at))
    return found


class _Made(NamedTuple):
    """An object at a wall, in the frame of the wall.

    Attributes:
        cloud: Points of the object.
        hole: Rectangle of the wall that the object covers.
        half: Half the width of the object [m].
        at: Position of its centre along the wall [m].
        reach: Depth of the object into the room [m]; 0 for an object that hangs on or lies in the wall.
        extras: Objects that stand on it.
    """

    cloud: Cloud
    hole: Hole
    half: float
    at: float
    reach: float = 0.0
    extras: tuple[Item, ...] = ()


def _blocks(interior: Interior, thing: str, made: _Made, x: float, y: float, yaw: float) -> bool:
    """Occupy the floor in front of an object at a wall; return whether it was occupied before."""
    reach = made.reach if made.reach else (0.9 if thing == "door" else 0.0)
    if not reach:
        return False
    ends = np.array([[made.at - made.half, 0.0], [made.at + made.half, reach]])
    c, s = np.cos(yaw), np.sin(yaw)
    on_floor: Floats = ends @ np.array([[c, s], [-s, c]]) + [x, y]
    (x0, y0), (x1, y1) = on_floor.min(axis=0).tolist(), on_floor.max(axis=0).tolist()
    place = (x0, x1, y0, y1)
    if interior.is_taken(place):
        return True
    interior.taken.append(place)
    if made.reach:
        interior.covered.append(place)
    return False


def _door(interior: Interior, at: float) -> _Made:
    brush, half, high = interior.brush, interior.brush.rng.uniform(0.42, 0.52), interior.brush.rng.uniform(2.0, 2.15)
    back = brush.rng.uniform(0.01, 0.08)
    colour = brush.shade_of((160, 120, 85), 25)
    leaf = brush.rectangle([at - half, -back, 0], [2 * half, 0, 0], [0, 0, high], colour)
    lintel = brush.box([at - half, -back, high], [2 * half, back + 0.02, 0.06], colour, ("+y", "-z"))
    return _Made(joined([leaf, lintel]), (at - half, at + half, 0, high + 0.06), half, at)


def _window(interior: Interior, at: float) -> _Made:
    brush, rng = interior.brush, interior.brush.rng
    half, low, high = rng.uniform(0.5, 0.85), rng.uniform(0.7, 1.0), rng.uniform(0.9, 1.3)
    back, frame = rng.uniform(0.05, 0.15), brush.shade_of((225, 225, 225), 10)
    glass = brush.rectangle([at - half, -back, low], [2 * half, 0, 0], [0, 0, high], brush.shade_of((150, 180, 205)))
    sill = brush.box([at - half, -back, low - 0.03], [2 * half, back + 0.03, 0.03], frame, ("+y", "+z"))
    bar = brush.box([at - 0.03, -back, low], [0.06, 0.05, high], frame, ("-x", "+x", "+y"))
    return _Made(joined([glass, sill, bar]), (at - half, at + half, low - 0.03, low + high), half, at)


def _board(interior: Interior, at: float) -> _Made:
    brush, rng = interior.brush, interior.brush.rng
    half, low, high = rng.uniform(0.6, 0.95), rng.uniform(0.8, 1.0), rng.uniform(0.9, 1.2)
    colour = brush.shade_of((240, 240, 240) if rng.random() < 0.7 else (40, 70, 60), 8)
    slab = brush.box([at - half, 0.005, low], [2 * half, 0.025, high], colour, ("-x", "+x", "+y", "+z"))
    tray = brush.box([at - half, 0.03, low - 0.02], [2 * half, 0.06, 0.02], furniture.METAL, ("+y", "+z"))
    return _Made(joined([slab, tray]), (at - half, at + half, low, low + high), half, at)


def _bookcase(interior: Interior, at: float) -> _Made:
    brush, rng = interior.brush, interior.brush.rng
    width, depth, high = rng.uniform(0.6, 1.1), rng.uniform(0.28, 0.4), rng.uniform(1.0, 2.1)
    cloud = moved(furniture.bookcase(brush, width, depth, high), 0.0, (at, depth / 2 + 0.01, 0))
    row = rng.uniform(0.2, width - 0.15)
    pile = moved(furniture.books(brush, row), 0.0, (at, depth / 2, high)) if high < 1.9 else None
    extras = () if pile is None else (Item("clutter", pile),)
    return _Made(cloud, (at - width / 2, at + width / 2, 0, high), width / 2, at, depth + 0.01, extras)


def _sofa(interior: Interior, at: float) -> _Made:
    width, depth = interior.brush.rng.uniform(1.2, 1.9), interior.brush.rng.uniform(0.75, 0.95)
    cloud = moved(furniture.sofa(interior.brush, width, depth), 0.0, (at, depth / 2 + 0.05, 0))
    return _Made(cloud, (at - width / 2, at + width / 2, 0, 0.7), width / 2, at, depth + 0.05)


def _column(interior: Interior, at: float) -> _Made:
    side, height = interior.brush.rng.uniform(0.3, 0.5), interior.size[2]
    colour = interior.brush.shade_of(interior.paint, 12)
    cloud = moved(furniture.column(interior.brush, side, height, colour), 0.0, (at, side / 2, 0))
    return _Made(cloud, (at - side / 2, at + side / 2, 0, height), side / 2, at, side)


_MAKERS: dict[str, Callable[[Interior, float], _Made]] = {
    "door": _door,
    "window": _window,
    "board": _board,
    "bookcase": _bookcase,
    "sofa": _sofa,
    "column": _column,
}
_WIDTHS = {"door": 1.04, "window": 1.7, "board": 1.9, "bookcase": 1.1, "sofa": 1.9, "column": 0.5}  # greatest [m]
