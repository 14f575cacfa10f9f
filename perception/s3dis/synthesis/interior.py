"""A room while it is being furnished: what is in it, and where there is still room.

The room's frame has its origin in a corner of the floor, x along the width, y along the depth, z up.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

from perception.s3dis.synthesis.solids import Brush, Cloud, Colour, Hole, moved


class Item(NamedTuple):
    """An object of a category."""

    category: str
    cloud: Cloud


@dataclass(eq=False)
class Interior:
    """A room being furnished.

    Attributes:
        brush: Lays the points.
        size: Width, depth, height [m].
        paint: Colour of the walls.
        items: What is there, so far.
        taken: Parts of the floor, as least x, greatest x, least y, greatest y [m].
        covered: Those of them where the floor is not seen.
    """

    brush: Brush
    size: tuple[float, float, float]
    paint: Colour
    items: list[Item] = field(default_factory=list)
    taken: list[Hole] = field(default_factory=list)
    covered: list[Hole] = field(default_factory=list)

    def is_free(self, place: Hole) -> bool:
        """Return whether a part of the floor lies in the room and is not taken."""
        x0, x1, y0, y1 = place
        inside = x0 >= 0.05 and y0 >= 0.05 and x1 <= self.size[0] - 0.05 and y1 <= self.size[1] - 0.05
        return inside and not self.is_taken(place)

    def is_taken(self, place: Hole) -> bool:
        """Return whether a part of the floor overlaps with one that is taken."""
        x0, x1, y0, y1 = place
        return any(x0 < b and a < x1 and y0 < d and c < y1 for a, b, c, d in self.taken)

    def find_place(self, length: float, depth: float) -> tuple[float, float] | None:
        """Draw the middle of a free part of the floor and take it; None if 40 draws find none."""
        for _ in range(40):
            x, y = self.brush.rng.uniform([0, 0], self.size[:2])
            place = (x - length / 2, x + length / 2, y - depth / 2, y + depth / 2)
            if self.is_free(place):
                self.taken.append(place)
                return float(x), float(y)
        return None

    def put(self, category: str, cloud: Cloud, x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> None:
        """Add an object that was made about the origin."""
        self.items.append(Item(category, moved(cloud, yaw, (x, y, z))))
