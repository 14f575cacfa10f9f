"""Kinds of synthetic rooms and their furniture. Furniture does not collide; chairs are pushed under tables."""

from dataclasses import dataclass

import numpy as np

from perception.s3dis.synthesis import furniture
from perception.s3dis.synthesis.interior import Interior, Item
from perception.s3dis.synthesis.solids import Brush, Hole
from perception.s3dis.synthesis.walls import build_walls


@dataclass(frozen=True, kw_only=True)
class RoomKind:
    """Distribution of the rooms of a kind.

    Attributes:
        width: Least and greatest width [m].
        depth: Least and greatest depth [m].
        on_walls: Mean number per metre of wall of doors, windows, boards, bookcases, sofas and columns.
        desks: Least and greatest number of desks, each with a chair.
        seats: Least and greatest number of chairs at a long table in the middle; (0, 0) for no table.
        coffee_tables: Least and greatest number of round tables.
    """

    width: tuple[float, float]
    depth: tuple[float, float]
    on_walls: tuple[float, float, float, float, float, float]
    desks: tuple[int, int] = (0, 0)
    seats: tuple[int, int] = (0, 0)
    coffee_tables: tuple[int, int] = (0, 0)


KINDS = {
    "office": RoomKind(width=(3.0, 5.5), depth=(3.0, 5.5), on_walls=(0.08, 0.14, 0.08, 0.16, 0.03, 0.05), desks=(2, 5)),
    "conferenceRoom": RoomKind(
        width=(4.0, 6.0), depth=(4.5, 8.0), on_walls=(0.08, 0.16, 0.14, 0.04, 0.03, 0.05), seats=(4, 10)
    ),
    "lounge": RoomKind(
        width=(3.5, 6.0), depth=(3.5, 6.0), on_walls=(0.08, 0.14, 0.05, 0.08, 0.20, 0.06), coffee_tables=(1, 3)
    ),
    "hallway": RoomKind(width=(1.8, 2.8), depth=(6.0, 12.0), on_walls=(0.22, 0.03, 0.06, 0.04, 0.03, 0.05)),
}


def make_interior(kind: RoomKind, brush: Brush) -> list[Item]:
    """Return the objects of a room."""
    rng = brush.rng
    size = (rng.uniform(*kind.width), rng.uniform(*kind.depth), rng.uniform(2.5, 3.2))
    interior = Interior(brush=brush, size=size, paint=brush.shade_of((215, 210, 200), 15))
    build_walls(interior, kind.on_walls)
    _build_ceiling(interior)
    _seat_meeting(interior, int(rng.integers(kind.seats[0], kind.seats[1] + 1)))
    for _ in range(rng.integers(kind.desks[0], kind.desks[1] + 1)):
        _place_desk(interior)
    for _ in range(rng.integers(kind.coffee_tables[0], kind.coffee_tables[1] + 1)):
        _place_coffee_table(interior)
    for _ in range(rng.integers(2, 7)):
        place = interior.find_place(0.45, 0.45)
        if place is not None:
            interior.put("clutter", furniture.clutter(brush), *place, yaw=rng.uniform(0, 2 * np.pi))
    floor = brush.pierced(
        [0, 0, 0], [size[0], 0, 0], [0, size[1], 0], brush.shade_of((125, 115, 105)), interior.covered
    )
    return [Item("floor", floor), *interior.items]


def _build_ceiling(interior: Interior) -> None:
    brush, (width, depth, height) = interior.brush, interior.size
    rng, covered = brush.rng, list[Hole]()
    for _ in range(rng.choice([0, 0, 1, 2])):
        y, thick, low = rng.uniform(0.5, depth - 0.8), rng.uniform(0.2, 0.35), rng.uniform(0.2, 0.4)
        if any(y < d and c < y + thick for _, _, c, d in covered):
            continue
        covered.append((0, width, y, y + thick))
        beam = brush.box(
            [0, y, height - low], [width, thick, low], brush.shade_of(interior.paint, 10), ("-y", "+y", "-z")
        )
        interior.items.append(Item("beam", beam))
    colour = brush.shade_of((235, 235, 230), 8)
    ceiling = brush.pierced([0, 0, height], [width, 0, 0], [0, depth, 0], colour, covered)
    interior.items.append(Item("ceiling", ceiling))
    for _ in range(int(width * depth / 8) + 1):
        x, y = rng.uniform([0.4, 0.8], [width - 0.4, depth - 0.8])
        if not any(c - 0.7 < y < d + 0.7 for _, _, c, d in covered):
            interior.put("clutter", furniture.lamp(brush), x, y, height)


def _place_desk(interior: Interior) -> None:
    """Put a desk somewhere, a chair before it and perhaps something on it."""
    brush, rng = interior.brush, interior.brush.rng
    length, depth, across = rng.uniform(1.1, 1.7), rng.uniform(0.6, 0.8), rng.random() < 0.5
    front = depth + 0.5  # with the chair
    place = interior.find_place(front, length) if across else interior.find_place(length, front)
    if place is None:
        return
    yaw = (np.pi / 2 if across else 0.0) + (np.pi if rng.random() < 0.5 else 0.0)
    seat, desk = _ahead(place, yaw, 0.3), _ahead(place, yaw, -0.25)
    interior.put("table", furniture.table(brush, length, depth), *desk, yaw=yaw)
    interior.put("chair", furniture.chair(brush), *seat, yaw=yaw + np.pi + rng.normal(0, 0.3))
    for _ in range(rng.integers(0, 3)):
        on = _ahead(desk, yaw + np.pi / 2, rng.uniform(-0.4, 0.4) * length)
        interior.put("clutter", furniture.clutter(brush, screens=True), *on, z=0.75, yaw=yaw)


def _seat_meeting(interior: Interior, seats: int) -> None:
    """Put a long table in the middle and chairs along both of its sides, pushed under it."""
    if seats < 1:
        return
    brush, rng = interior.brush, interior.brush.rng
    per_side = (seats + 1) // 2
    length = min(0.65 * per_side + 0.3, interior.size[1] - 1.5)
    depth, (x, y) = rng.uniform(0.9, 1.2), (interior.size[0] / 2, interior.size[1] / 2)
    interior.taken.append((x - depth / 2 - 0.5, x + depth / 2 + 0.5, y - length / 2, y + length / 2))
    interior.put("table", furniture.table(brush, length, depth), x, y, yaw=np.pi / 2)
    for k in range(seats):
        along = y + (k // 2 + 0.5) / per_side * length - length / 2
        side = 1 if k % 2 else -1
        away = depth / 2 + rng.uniform(0.0, 0.25)
        yaw = side * np.pi / 2 + rng.normal(0, 0.2)
        interior.put("chair", furniture.chair(brush), x + side * away, along, yaw=yaw)


def _place_coffee_table(interior: Interior) -> None:
    radius = interior.brush.rng.uniform(0.3, 0.5)
    place = interior.find_place(2 * radius + 0.9, 2 * radius + 0.2)
    if place is None:
        return
    interior.put("table", furniture.round_table(interior.brush, radius), *place)
    for side in (-1, 1):
        if interior.brush.rng.random() < 0.6:
            x = place[0] + side * (radius + 0.2)
            interior.put("chair", furniture.chair(interior.brush), x, place[1], yaw=side * np.pi / 2)


def _ahead(place: tuple[float, float], yaw: float, distance: float) -> tuple[float, float]:
    """Return the point ``distance`` towards the front of something that is turned by ``yaw``."""
    return place[0] - np.sin(yaw) * distance, place[1] + np.cos(yaw) * distance
