"""A drawn part before it is scaled, and the symmetry groups that drawings declare."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from binpick_env.parts.families.solid import Solid
from perception.geometry import Floats, rotation_about
from perception.part import Symmetry

X, Y, Z = np.eye(3)


@dataclass(frozen=True, eq=False, kw_only=True)
class Drawing:
    """A part as a family draws it, in any unit of length.

    Attributes:
        solid: Mesh and convex pieces.
        wall: Thickness of the thinnest wall, in the drawing's unit.
        symmetry: Symmetry group about the volume's centroid, known by construction.
    """

    solid: Solid
    wall: float
    symmetry: Symmetry = field(default_factory=Symmetry)


Builder = Callable[[np.random.Generator], Drawing]
ROUND = Symmetry(axis=Z)
ROUND_BOTH_WAYS = Symmetry(rotations=np.stack([np.eye(3), rotation_about(X, np.pi)]), axis=Z)


def cyclic(order: int, axis: Floats = Z) -> Symmetry:
    """Return the group of ``order`` equal turns about an axis."""
    return Symmetry(rotations=np.stack([rotation_about(axis, 2 * np.pi * k / order) for k in range(order)]))


def dihedral(order: int, axis: Floats = Z, across: Floats = X) -> Symmetry:
    """Return ``order`` equal turns about an axis, each with and without a half turn about ``across``."""
    turns = cyclic(order, axis).rotations
    return Symmetry(rotations=np.concatenate([turns, turns @ rotation_about(across, np.pi)]))


def chance(rng: np.random.Generator, probability: float = 0.5) -> bool:
    """Draw whether an optional feature is there."""
    return bool(rng.random() < probability)
