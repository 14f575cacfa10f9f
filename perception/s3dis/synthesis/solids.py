"""Random points on the simple surfaces of synthetic furniture."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from perception.geometry import Floats

Hole = tuple[float, float, float, float]  # start and end along the first edge, start and end along the second [m]
Colour = tuple[float, float, float]  # red, green, blue, 0 to 255
SEEN = ("-x", "+x", "-y", "+y", "+z")  # faces of a box that a scanner in the room sees: all but the underside


class Cloud(NamedTuple):
    """Points on surfaces.

    Attributes:
        points: (N, 3) points [m].
        normals: (N, 3) unit normals of either sign.
        colours: (N, 3) colours without light and noise, 0 to 255.
    """

    points: Floats
    normals: Floats
    colours: Floats


@dataclass(frozen=True, eq=False)
class Brush:
    """Sampler of points on surfaces.

    Attributes:
        density: Number of points per square metre.
        rng: Source of the draws.
    """

    density: float
    rng: np.random.Generator

    def rectangle(self, origin: Sequence[float], u: Sequence[float], v: Sequence[float], colour: Colour) -> Cloud:
        """Sample the rectangle of the perpendicular edges ``u`` and ``v`` [m]."""
        return self.pierced(origin, u, v, colour, ())

    def pierced(
        self, origin: Sequence[float], u: Sequence[float], v: Sequence[float], colour: Colour, holes: Sequence[Hole]
    ) -> Cloud:
        """Sample a rectangle except for its holes."""
        a, b = np.array(u, float), np.array(v, float)
        lengths = np.linalg.norm([a, b], axis=1)
        place = self.rng.uniform(size=(self._count(lengths.prod()), 2))
        for s0, s1, t0, t1 in holes:
            s, t = (place * lengths).T
            place = place[~((s > s0) & (s < s1) & (t > t0) & (t < t1))]
        points = np.array(origin, float) + place[:, :1] * a + place[:, 1:] * b
        normal = np.cross(a, b) / max(lengths.prod(), 1e-12)
        return _coloured(points, np.tile(normal, (len(points), 1)), colour)

    def box(self, low: Sequence[float], size: Sequence[float], colour: Colour, faces: Sequence[str] = SEEN) -> Cloud:
        """Sample faces of a box whose least corner is ``low`` [m]."""
        corner, edges = np.array(low, float), np.diag(np.array(size, float))
        clouds = []
        for face in faces:
            axis = "xyz".index(face[1])
            u, v = (edges[k] for k in range(3) if k != axis)
            origin = corner + edges[axis] * (face[0] == "+")
            clouds.append(self.rectangle(origin.tolist(), u.tolist(), v.tolist(), colour))
        return joined(clouds)

    def cylinder(self, base: Sequence[float], radius: float, height: float, colour: Colour, cap: bool = True) -> Cloud:
        """Sample the side of an upright cylinder and, with ``cap``, its top."""
        count = self._count(2 * np.pi * radius * height)
        angle = self.rng.uniform(0, 2 * np.pi, count)
        around = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
        side = np.array(base, float) + radius * around
        side[:, 2] += self.rng.uniform(0, height, count)
        clouds = [_coloured(side, around, colour)]
        if cap:
            clouds.append(self.disc([base[0], base[1], base[2] + height], radius, colour))
        return joined(clouds)

    def disc(self, centre: Sequence[float], radius: float, colour: Colour) -> Cloud:
        """Sample a horizontal disc."""
        count = self._count(np.pi * radius**2)
        angle, distance = self.rng.uniform(0, 2 * np.pi, count), radius * np.sqrt(self.rng.uniform(size=count))
        points = np.array(centre, float) + np.column_stack(
            [distance * np.cos(angle), distance * np.sin(angle), np.zeros(count)]
        )
        return _coloured(points, np.tile([0.0, 0.0, 1.0], (count, 1)), colour)

    def shade_of(self, colour: Colour, spread: float = 25.0) -> Colour:
        """Draw a colour close to another one, which differs more in brightness than in hue."""
        shift = self.rng.normal(0, spread) + self.rng.normal(0, 0.3 * spread, 3)
        red, green, blue = np.clip(np.array(colour) + shift, 5, 250).tolist()
        return red, green, blue

    def _count(self, area: float) -> int:
        return int(area * self.density + self.rng.uniform())


def joined(clouds: Sequence[Cloud]) -> Cloud:
    """Return all points of several clouds."""
    empty = np.empty((0, 3))
    points, normals, colours = (np.concatenate([empty, *(c[k] for c in clouds)]) for k in range(3))
    return Cloud(points, normals, colours)


def moved(cloud: Cloud, yaw: float, to: Sequence[float]) -> Cloud:
    """Return a cloud rotated about z by ``yaw`` [rad], then translated by ``to`` [m]."""
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return Cloud(cloud.points @ turn.T + np.array(to, float), cloud.normals @ turn.T, cloud.colours)


def _coloured(points: Floats, normals: Floats, colour: Colour) -> Cloud:
    return Cloud(points, normals, np.tile(np.array(colour, float), (len(points), 1)))
