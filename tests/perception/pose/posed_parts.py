"""Small parts of every kind of symmetry, off the origin, and random poses of them."""

import numpy as np
import trimesh

from perception.geometry import Floats, make_transform, random_rotation, rotation_about
from perception.part import PartModel, Symmetry

X, Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
HALF_TURN = rotation_about(Z, np.pi)
FLIP = rotation_about(X, np.pi)
SHIFT = np.array([0.03, -0.02, 0.05])  # of the drawing's origin, so that a mistaken pivot shows
K = np.array([[600.0, 0.0, 319.5], [0.0, 620.0, 239.5], [0.0, 0.0, 1.0]])


def wedge() -> PartModel:
    """A scalene tetrahedron: no symmetry."""
    corners = np.array([(0.0, 0.0, 0.0), (0.06, 0.0, 0.0), (0.01, 0.04, 0.0), (0.02, 0.01, 0.03)])
    return PartModel.from_mesh("wedge", trimesh.convex.convex_hull(corners + SHIFT))


def lid() -> PartModel:
    """A flat roof: a half turn about z and no other."""
    top = [(x, y, 0.01) for x, y in ((-0.01, -0.008), (0.01, 0.008), (-0.005, 0.01), (0.005, -0.01))]
    corners = np.array([(x, y, 0.0) for x in (-0.04, 0.04) for y in (-0.025, 0.025)] + top)
    turns = Symmetry(rotations=np.stack([np.eye(3), HALF_TURN]))
    return PartModel.from_mesh("lid", trimesh.convex.convex_hull(corners + SHIFT), turns)


def wheel(sections: int = 12) -> PartModel:
    """A stepped wheel: a solid of revolution whose ends differ."""
    profile = np.array([(0.0, 0.0), (0.04, 0.0), (0.04, 0.015), (0.02, 0.015), (0.02, 0.035), (0.0, 0.035)])
    mesh = trimesh.creation.revolve(profile, sections=sections)
    mesh.apply_translation(SHIFT)
    return PartModel.from_mesh("wheel", mesh, Symmetry(axis=Z))


def rod(sections: int = 12) -> PartModel:
    """A cylinder: a solid of revolution whose ends are alike."""
    mesh = trimesh.creation.cylinder(radius=0.01, height=0.06, sections=sections)
    mesh.apply_translation(SHIFT)
    return PartModel.from_mesh("rod", mesh, Symmetry(rotations=np.stack([np.eye(3), FLIP]), axis=Z))


def cube(symmetry: Symmetry | None = None) -> PartModel:
    """A cube of half side 0.01 about the origin."""
    return PartModel.from_mesh("cube", trimesh.creation.box(extents=(0.02, 0.02, 0.02)), symmetry)


PARTS = (wedge(), lid(), wheel(), rod())


def about_centre(part: PartModel, rotation: Floats) -> Floats:
    """Return the (4, 4) turn of a part about its own centre."""
    return make_transform(rotation, part.centre - rotation @ part.centre)


def random_pose(rng: np.random.Generator) -> Floats:
    """Return a (4, 4) T_cam_part about a metre before the camera."""
    return make_transform(random_rotation(rng), rng.uniform((-0.2, -0.2, 0.8), (0.2, 0.2, 1.1)))


def random_nearby(T: Floats, part: PartModel, rng: np.random.Generator, size: float) -> Floats:
    """Return a pose about ``size`` rad and as many decimetres from ``T``; 0 gives ``T`` itself."""
    tilt = about_centre(part, rotation_about(rng.normal(size=3), size * rng.normal()))
    return make_transform(None, 0.1 * size * rng.normal(size=3)) @ T @ tilt


def three_poses(part: PartModel, seed: int, size: float) -> tuple[Floats, Floats, Floats]:
    """Return a pose and two about ``size`` away from it."""
    rng = np.random.default_rng(seed)
    a = random_pose(rng)
    return a, random_nearby(a, part, rng, size), random_nearby(a, part, rng, size)


def random_element(part: PartModel, rng: np.random.Generator) -> Floats:
    """Return a (4, 4) turn of a part about its centre that cannot be seen."""
    rotation = part.symmetry.rotations[rng.integers(len(part.symmetry.rotations))]
    if part.symmetry.axis is not None:
        rotation = rotation @ rotation_about(part.symmetry.axis, rng.uniform(0, 2 * np.pi))
    return about_centre(part, rotation)
