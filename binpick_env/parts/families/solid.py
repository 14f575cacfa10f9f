"""Constructive solid geometry that keeps a part's convex pieces beside its mesh.

Every primitive comes with the convex bodies that make it up, so a drawing needs no convex decomposition afterwards.
Adding solids joins their meshes and collects their pieces. Subtracting a solid bores the mesh and leaves the pieces.
Lengths have any unit, since a finished part is scaled; angles are in degrees, as manifold3d takes them.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from manifold3d import Manifold, Mesh64, OpType
from numpy.typing import ArrayLike

from perception.geometry import Floats

FACETS = 60  # facets of a full turn in the mesh; a multiple of 3, 4 and 5, so that most symmetries are exact
PIECE_FACETS = 32  # facets of a full turn in the pieces: within 0.5 % of the radius, and 64 vertices a cylinder
OVERLAP = 2e-3  # length by which solids overlap where a turn would round their common face apart
Limits = tuple[float, float]


@dataclass(frozen=True, eq=False, kw_only=True)
class Solid:
    """A solid as drawn, with its convex pieces.

    Attributes:
        mesh: The solid with all its bores.
        filled: The solid without the bores that its pieces ignore.
        pieces: Convex bodies that cover ``filled``.
    """

    mesh: Manifold
    filled: Manifold
    pieces: tuple[Manifold, ...]

    def __add__(self, other: "Solid") -> "Solid":
        """Join two solids."""
        return Solid(mesh=self.mesh + other.mesh, filled=self.filled + other.filled, pieces=self.pieces + other.pieces)

    def __sub__(self, bore: "Solid") -> "Solid":
        """Bore the mesh; the pieces stay."""
        return Solid(mesh=self.mesh - bore.mesh, filled=self.filled, pieces=self.pieces)

    def at(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> "Solid":
        """Return the solid moved."""
        return self._mapped(lambda body: body.translate((x, y, z)))

    def rotated(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> "Solid":
        """Return the solid turned about the fixed x, then y, then z axis [deg]."""
        return self._mapped(lambda body: body.rotate((x, y, z)))

    def mirrored(self, normal: tuple[float, float, float]) -> "Solid":
        """Return the mirror image across the plane through the origin with the given normal."""
        return self._mapped(lambda body: body.mirror(normal))

    def repeated(self, count: int) -> "Solid":
        """Return ``count`` copies at equal angles about z."""
        return total(self.rotated(z=360.0 * k / count) for k in range(count))

    def _mapped(self, change: Callable[[Manifold], Manifold]) -> "Solid":
        pieces = tuple(change(piece) for piece in self.pieces)
        return Solid(mesh=change(self.mesh), filled=change(self.filled), pieces=pieces)


def total(solids: Iterable[Solid]) -> Solid:
    """Return the sum of one or more solids."""
    each = list(solids)
    joined = each[0]
    for solid in each[1:]:
        joined = joined + solid
    return joined


def hollow(body: Solid, bore: Solid, pieces: Iterable[Solid]) -> Solid:
    """Return ``body`` with a bore that its pieces, given here, leave open."""
    mesh = body.mesh - bore.mesh
    return Solid(mesh=mesh, filled=mesh, pieces=tuple(piece for solid in pieces for piece in solid.pieces))


def hull_of(*solids: Solid) -> Solid:
    """Return the convex hull of solids as one piece."""
    mesh = Manifold.batch_hull([solid.mesh for solid in solids])
    return Solid(mesh=mesh, filled=mesh, pieces=(Manifold.batch_hull([p for s in solids for p in s.pieces]),))


def hull_points(points: ArrayLike) -> Solid:
    """Return the convex hull of (N, 3) points."""
    return _convex(Manifold.hull_points(np.asarray(points, dtype=np.float64)))


def box(x: Limits, y: Limits, z: Limits) -> Solid:
    """Return the axis-aligned box between the given limits."""
    return hull_points([(a, b, c) for a in x for b in y for c in z])


def plate(length: float, width: float, z: Limits, corner: float = 0.0) -> Solid:
    """Return a plate centred on the z axis, its corners rounded with radius ``corner``."""
    if corner <= 0:
        return box((-length / 2, length / 2), (-width / 2, width / 2), z)
    x, y = length / 2 - corner, width / 2 - corner
    return hull_of(*(cylinder(2 * corner, z).at(sx * x, sy * y) for sx in (-1, 1) for sy in (-1, 1)))


def cylinder(diameter: float, z: Limits, top: float | None = None) -> Solid:
    """Return a cylinder about z, or the frustum that ends in the diameter ``top``."""
    ends = [(diameter / 2, z[0]), ((diameter if top is None else top) / 2, z[1])]
    fine, coarse = _disc_hull(ends, FACETS), _disc_hull(ends, PIECE_FACETS)
    return Solid(mesh=fine, filled=fine, pieces=(coarse,))


def rod(diameter: float, start: ArrayLike, stop: ArrayLike) -> Solid:
    """Return a cylinder from one point to another."""
    start, stop = np.asarray(start, dtype=np.float64), np.asarray(stop, dtype=np.float64)
    x, y, z = stop - start
    tilt, turn = np.rad2deg(np.arctan2(np.hypot(x, y), z)), np.rad2deg(np.arctan2(y, x))
    along = cylinder(diameter, (0.0, float(np.linalg.norm(stop - start))))
    return along.rotated(y=float(tilt)).rotated(z=float(turn)).at(*start.tolist())


def prism(polygon: ArrayLike, z: Limits) -> Solid:
    """Return the convex prism over the hull of (N, 2) points."""
    points = np.asarray(polygon, dtype=np.float64)
    return hull_points([(*point, height) for point in points for height in z])


def profile(*polygons: Sequence[tuple[float, float]], width: float) -> Solid:
    """Return the bar of length ``width`` along y whose section in xz is the union of convex polygons."""
    ends = (-width / 2, width / 2)
    return total(hull_points([(x, y, z) for x, z in polygon for y in ends]) for polygon in polygons)


def regular(sides: int, across: float, z: Limits) -> Solid:
    """Return the prism over a regular polygon of an even number of sides, ``across`` its flats; a corner is on x."""
    angles = 2 * np.pi * np.arange(sides) / sides
    radius = across / 2 / np.cos(np.pi / sides)
    return prism(radius * np.stack([np.cos(angles), np.sin(angles)], axis=1), z)


def turned(outline: Sequence[tuple[float, float]]) -> Solid:
    """Return the solid of revolution about z under an outline of (radius, height) points, height never falling.

    The pieces are the longest stretches of the outline whose solids are convex.
    """
    points = np.asarray(outline, dtype=np.float64)
    stretches, start = [], 0
    while start < len(points) - 1:
        stop = start + 1
        while stop + 1 < len(points) and _bulges(points[start : stop + 2]):
            stop += 1
        if points[stop, 1] > points[start, 1]:
            stretches.append(points[start : stop + 1])
        start = stop
    mesh = Manifold.batch_boolean([_disc_hull(each, FACETS) for each in stretches], OpType.Add)
    return Solid(mesh=mesh, filled=mesh, pieces=tuple(_disc_hull(each, PIECE_FACETS) for each in stretches))


def revolved(section: ArrayLike, *, angle: float = 360.0, sectors: int = 8) -> Solid:
    """Return a convex (N, 2) section of (radius, height) points revolved about z from the x axis.

    Args:
        section: (N, 2) corners of the section, counter-clockwise.
        angle: Angle that the section sweeps [deg].
        sectors: Number of convex pieces; their inner sides are chords, their outer sides lie on the mesh.
    """
    points = np.asarray(section, dtype=np.float64)
    mesh = _swept(points, angle)
    few = points[:: max(1, len(points) // 12)]
    steps = max(2, round(PIECE_FACETS * angle / 360.0 / sectors) + 1)
    pieces = []
    for k in range(sectors):
        turns = np.deg2rad(np.linspace(k, k + 1, steps) * angle / sectors)
        corners = [(r * np.cos(t), r * np.sin(t), h) for t in turns for r, h in few]
        pieces.append(Manifold.hull_points(np.array(corners)))
    return Solid(mesh=mesh, filled=mesh, pieces=tuple(pieces))


def tube(outer: float, inner: float, z: Limits, *, sectors: int = 8) -> Solid:
    """Return a tube about z between two diameters, with its bore open in the pieces too."""
    return revolved([(inner / 2, z[0]), (outer / 2, z[0]), (outer / 2, z[1]), (inner / 2, z[1])], sectors=sectors)


def bend(radius: float, diameter: float, *, angle: float = 360.0, sectors: int = 8) -> Solid:
    """Return a round bar of ``diameter`` bent about z with the given radius of its axis, from the x axis on."""
    turns = 2 * np.pi * np.arange(36) / 36
    section = np.stack([radius + diameter / 2 * np.cos(turns), diameter / 2 * np.sin(turns)], axis=1)
    return revolved(section, angle=angle, sectors=sectors)


def without_slivers(body: Manifold) -> Manifold:
    """Return a body without the components of no volume that rounding leaves where surfaces coincide."""
    least = 1e-9 * body.volume()
    return Manifold.compose([component for component in body.decompose() if component.volume() > least])


def as_trimesh(body: Manifold) -> trimesh.Trimesh:
    """Return a body as a mesh with float64 vertices."""
    arrays = body.to_mesh64()
    vertices = np.asarray(arrays.vert_properties, dtype=np.float64)[:, :3]
    return trimesh.Trimesh(vertices, np.asarray(arrays.tri_verts, dtype=np.int64), process=False)


def _convex(body: Manifold) -> Solid:
    return Solid(mesh=body, filled=body, pieces=(body,))


def _bulges(points: Floats) -> bool:
    """Tell whether the solid under (N, 2) outline points is convex."""
    ring = np.vstack([[(0.0, points[0, 1])], points, [(0.0, points[-1, 1])]])
    ax, ay = (np.roll(ring, -1, axis=0) - ring).T
    bx, by = np.roll(ax, -1), np.roll(ay, -1)
    return bool(np.all(ax * by - ay * bx > -1e-9))


def _disc_hull(rings: ArrayLike, facets: int) -> Manifold:
    """Return the hull of circles about z of given (radius, height); the heights are kept to the last bit."""
    turns = 2 * np.pi * np.arange(facets) / facets
    corners = [(r * np.cos(t), r * np.sin(t), h) for r, h in np.asarray(rings) for t in turns]
    return Manifold.hull_points(np.array(corners))


def _swept(section: Floats, angle: float) -> Manifold:
    """Return a convex (N, 2) section, counter-clockwise, revolved about z by ``angle`` [deg] from the x axis on."""
    whole, corners = angle >= 360.0, len(section)
    steps = round(FACETS * angle / 360.0)
    turns = np.deg2rad(angle) * np.arange(steps + (0 if whole else 1)) / steps
    vertices = [(r * np.cos(t), r * np.sin(t), h) for t in turns for r, h in section]
    here = np.arange(steps)[:, None] * corners + np.arange(corners)
    ahead = np.roll(here, -1, axis=1)
    there, beyond = (each + corners for each in (here, ahead))
    if whole:
        there, beyond = (each % (steps * corners) for each in (there, beyond))
    faces = [np.stack([here, there, beyond], axis=-1), np.stack([here, beyond, ahead], axis=-1)]
    triangles = np.concatenate([each.reshape(-1, 3) for each in faces])
    if not whole:
        k = np.arange(1, corners - 1)
        start = np.stack([np.zeros_like(k), k, k + 1], axis=1)
        triangles = np.concatenate([triangles, start, start[:, ::-1] + steps * corners])
    return Manifold(Mesh64(vert_properties=np.array(vertices), tri_verts=triangles.astype(np.uint64)))
