"""Parametric CAD of the catalogue's five parts.

Every part is a union of a few convex bodies minus some bores. The bodies without the bores double as the part's
collision pieces: they lie on the mesh exactly wherever a finger can reach, since no bore admits one.
The part frame's origin is the volume's centroid, its axes are the natural ones named in each builder. Lengths [m].
"""

from collections.abc import Callable

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from binpick_env.parts.design import Design, Solids
from perception.geometry import Floats, make_transform, rotation_about
from perception.part import Symmetry

# Facets of a full turn in the mesh: within 0.05 mm of a circle of 40 mm; a multiple of 4, for exact half turns.
FACETS = 64
PIECE_FACETS = 32  # facets of a full turn in the collision pieces: within 0.2 mm at 40 mm, and 64 vertices a cylinder
X, Y, Z = np.eye(3)


def design(name: str) -> Design:
    """Build a part by its catalogue name.

    Raises:
        ValueError: If there is no such name.
    """
    if name not in _BUILDERS:
        raise ValueError(f"part must be one of {', '.join(CATALOGUE)}, got {name!r}")
    build, density, symmetry = _BUILDERS[name]
    bodies, bores = build(FACETS)
    pieces = tuple(body.convex_hull for body in build(PIECE_FACETS)[0])  # without the vertices in the caps' middles
    mesh = trimesh.boolean.difference([trimesh.boolean.union(bodies, engine="manifold"), *bores], engine="manifold")
    origin = mesh.center_mass.copy()
    for solid in (mesh, *pieces):
        solid.apply_translation(-origin)
    return Design(name=name, mesh=mesh, pieces=pieces, density=density, symmetry=symmetry)


def part_a(facets: int) -> tuple[Solids, Solids]:
    """Stepped wheel: a disc and a hub on one shaft bore; z along the shaft, towards the hub."""
    disc = cylinder(0.072, 0.0, 0.016, facets=facets)
    hub = cylinder(0.038, 0.006, 0.056, facets=facets)
    return (disc, hub), (cylinder(0.012, -0.01, 0.07, facets=facets),)


def part_b(facets: int) -> tuple[Solids, Solids]:
    """Flat lid: a bevelled plate, a skirt below and an ear at each end; z out of the plate, x along."""
    outline = [(x, y, z) for x in (-0.035, 0.035) for y in (-0.028, 0.028) for z in (0.0, 0.002)]
    top = [(x, y, 0.006) for x in (-0.027, 0.027) for y in (-0.020, 0.020)]
    plate = trimesh.convex.convex_hull(np.array(outline + top))
    skirts = [box((-0.035, 0.035), (y, y + 0.004), (-0.009, 0.002)) for y in (-0.028, 0.024)]
    skirts += [box((x, x + 0.004), (-0.028, 0.028), (-0.009, 0.002)) for x in (-0.035, 0.031)]
    ears = [
        box((0.031, 0.044), (0.002, 0.020), (-0.003, 0.002)),
        box((-0.044, -0.031), (-0.020, -0.002), (-0.003, 0.002)),
    ]
    bores = [cylinder(0.005, -0.02, 0.02, at=(s * 0.0395, s * 0.011, 0.0), facets=facets // 2) for s in (1, -1)]
    return (plate, *skirts, *ears), tuple(bores)


def part_c(facets: int) -> tuple[Solids, Solids]:
    """Machined block: a shelf and a tower, a bore down through each; x from tower to shelf, z up."""
    shelf = box((0.0, 0.066), (-0.027, 0.027), (0.0, 0.020))
    tower = box((0.0, 0.032), (-0.027, 0.027), (0.0, 0.048))
    down = cylinder(0.014, -0.01, 0.03, at=(0.049, 0.0, 0.0), facets=facets // 2)
    along = cylinder(0.011, -0.01, 0.05, axis=X, at=(0.0, 0.0, 0.034), facets=facets // 2)
    return (shelf, tower), (down, along)


def tee(facets: int) -> tuple[Solids, Solids]:
    """Pipe tee with a collar at each mouth; x along the run, z along the branch."""
    run = cylinder(0.030, -0.0425, 0.0425, axis=X, facets=facets)
    branch = cylinder(0.030, 0.0, 0.050, facets=facets)
    collars = [cylinder(0.036, a, a + 0.014, axis=X, facets=facets) for a in (-0.0425, 0.0285)]
    collars.append(cylinder(0.036, 0.036, 0.050, facets=facets))
    bores = cylinder(0.020, -0.06, 0.06, axis=X, facets=facets), cylinder(0.020, 0.0, 0.06, facets=facets)
    return (run, branch, *collars), bores


def bracket(facets: int) -> tuple[Solids, Solids]:
    """Angle bracket: two legs, a rib in the corner, two holes a leg; x along the long leg, z along the short one."""
    foot = box((0.0, 0.056), (-0.031, 0.031), (0.0, 0.006))
    wall = box((0.0, 0.006), (-0.031, 0.031), (0.0, 0.050))
    profile = [(0.003, 0.003), (0.032, 0.003), (0.032, 0.006), (0.006, 0.032), (0.003, 0.032)]
    rib = trimesh.convex.convex_hull(np.array([(x, y, z) for x, z in profile for y in (-0.003, 0.003)]))
    holes = [cylinder(0.009, -0.01, 0.02, at=(0.038, y, 0.0), facets=facets // 2) for y in (-0.018, 0.018)]
    holes += [cylinder(0.009, -0.01, 0.02, axis=X, at=(0.0, y, 0.034), facets=facets // 2) for y in (-0.018, 0.018)]
    return (foot, wall, rib), tuple(holes)


def box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> trimesh.Trimesh:
    """Return the axis-aligned box between the given limits [m]."""
    solid: trimesh.Trimesh = trimesh.creation.box(bounds=np.stack([x, y, z], axis=1))
    return solid


def cylinder(
    diameter: float, start: float, stop: float, *, axis: Floats = Z, at: ArrayLike = (0.0, 0.0, 0.0), facets: int
) -> trimesh.Trimesh:
    """Return a cylinder from ``start`` to ``stop`` along ``axis`` (X or Z) through the point ``at`` [m]."""
    solid: trimesh.Trimesh = trimesh.creation.cylinder(
        radius=diameter / 2, segment=[(0, 0, start), (0, 0, stop)], sections=facets
    )
    # A quarter turn about y takes z to x and keeps the facets on the symmetry planes.
    turn = rotation_about(Y, np.pi / 2) if axis is X else np.eye(3)
    solid.apply_transform(make_transform(turn, at))
    return solid


HALF_TURN = Symmetry(rotations=np.stack([np.eye(3), rotation_about(Z, np.pi)]))
_BUILDERS: dict[str, tuple[Callable[[int], tuple[Solids, Solids]], float, Symmetry]] = {
    "part_a": (part_a, 2700.0, Symmetry(axis=Z)),  # aluminium; the two ends differ
    "part_b": (part_b, 2700.0, HALF_TURN),  # aluminium; the ears sit diagonally
    "part_c": (part_c, 2700.0, Symmetry()),  # aluminium
    "tee": (tee, 1400.0, HALF_TURN),  # rigid PVC; about the branch
    "bracket": (bracket, 7850.0, Symmetry()),  # steel
}
CATALOGUE: tuple[str, ...] = tuple(_BUILDERS)
