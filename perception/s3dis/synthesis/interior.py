"""A synthetic room while it is being furnished: its objects, and the free floor.

The origin of the room frame is a corner of the floor, with x along the width, y along the depth and z up.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

from perception.s3dis.synthesis.solids import Brush, Cloud, Colour, Hole, moved


class Item(NamedTuple):
    """An object: a category and points."""

    category: str
    cloud: Cloud


@dataclass(eq=False)
class Interior:
    """A room being furnished.

    Attributes:
        brush: Sampler of the points.
        size: Width, depth and height of the room [m].
        paint: Colour of the walls.
        items: Objects placed so far.
        taken: Occupied rectangles of the floor: least x, greatest x, least y, greatest y [m].
        covered: Rectangles where the floor is not visible.
    """

    brush: Brush
    size: tuple[float, float, float]
    paint: Colour
    items: list[Item] = field(default_factory=list)
    taken: list[Hole] = field(default_factory=list)
    covered: list[Hole] = field(default_factory=list)

    def is_free(self, place: Hole) -> bool:
        """Return whether a rectangle of the floor lies in the room and is not occupied."""
        x0, x1, y0, y1 = place
        inside = x0 >= 0.05 and y0 >= 0.05 and x1 <= self.size[0] - 0.05 and y1 <= self.size[1] - 0.05
        return inside and not self.is_taken(place)

    def is_taken(self, place: Hole) -> bool:
        """Return whether a rectangle of the floor overlaps with an occupied one."""
        x0, x1, y0, y1 = place
        return any(x0 < b and a < x1 and y0 < d and c < y1 for a, b, c, d in self.taken)

    def find_place(self, length: float, depth: float) -> tuple[float, float] | None:
        """Draw the centre of a free rectangle of the floor and occupy it; None if 40 draws find none."""
        for _ in range(40):
            x, y = self.brush.rng.uniform([0, 0], self.size[:2])
            place = (x - length / 2, x + length / 2, y - depth / 2, y + depth / 2)
            if self.is_free(place):
                self.taken.append(place)
                return float(x), float(y)
        return None

    def put(self, category: str, cloud: Cloud, x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> None:
        """Add an object that was made at the origin.

        Args:
            category: Category of the object.
            cloud: Points of the object about the origin.
            x: Position along the width [m].
            y: Position along the depth [m].
            z: Height [m].
            yaw: Rotation about z [rad].
        """
        self.items.append(Item(category, moved(cloud, yaw, (x, y, z))))
