"""What perception knows of a part: mesh, exact diameter, symmetry group, centre."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from perception.geometry import Floats, require_shape, rotation_about, rotation_angle


@dataclass(frozen=True, eq=False, kw_only=True)
class Symmetry:
    """The proper rotations about a part's centre that map its surface onto itself.

    The group is ``{R @ Rot(axis, t)}`` over ``rotations`` and, where there is an axis, every angle ``t``.

    Attributes:
        rotations: (S, 3, 3) float64 rotations in part axes, the identity first.
        axis: (3,) unit axis of a solid of revolution in part axes; None for any other part.
    """

    rotations: Floats = field(default_factory=lambda: np.eye(3)[None])
    axis: Floats | None = None

    def __post_init__(self) -> None:
        require_shape("rotations", self.rotations, (None, 3, 3))
        if len(self.rotations) == 0 or not np.allclose(self.rotations[0], np.eye(3)):
            raise ValueError("rotations must begin with the identity")
        gram = self.rotations @ np.swapaxes(self.rotations, -1, -2)
        if not np.allclose(gram, np.eye(3), atol=1e-9) or np.any(np.linalg.det(self.rotations) < 0):
            raise ValueError("rotations must be proper rotation matrices")
        if self.axis is not None:
            require_shape("axis", self.axis, (3,))
            if not np.isclose(np.linalg.norm(self.axis), 1.0):
                raise ValueError(f"axis must be a unit vector, got {self.axis.tolist()}")

    @property
    def order(self) -> float:
        """Number of group elements; infinite for a solid of revolution."""
        return np.inf if self.axis is not None else float(len(self.rotations))

    def elements(self, steps: int = 72) -> Floats:
        """Return the (M, 3, 3) group elements, the continuous axis sampled at ``steps`` equal angles."""
        if self.axis is None:
            return self.rotations
        turns = np.stack([rotation_about(self.axis, 2 * np.pi * k / steps) for k in range(steps)])
        products: Floats = np.einsum("sij,tjk->stik", self.rotations, turns)
        return products.reshape(-1, 3, 3)

    def distance(self, rotation_a: Floats, rotation_b: Floats) -> float:
        """Return the smallest angle [rad] between two (3, 3) part rotations modulo the group."""
        if self.axis is None:
            return float(np.min(rotation_angle(rotation_a @ self.rotations @ rotation_b.T)))
        # With free rotation about the axis, only the angle between the two images of the axis remains. This is exact.
        axes_a = (rotation_a @ self.rotations) @ self.axis
        axis_b = rotation_b @ self.axis
        cross = np.linalg.norm(np.cross(axes_a, axis_b), axis=-1)
        return float(np.min(np.arctan2(cross, axes_a @ axis_b)))


@dataclass(frozen=True, eq=False, kw_only=True)
class PartModel:
    """What perception knows of a part.

    Attributes:
        name: Catalogue name or file stem.
        mesh: Watertight triangle mesh in the part frame [m].
        d_max: Largest distance between two vertices [m], exact.
        symmetry: Rotations about ``centre`` that map the part onto itself.
        centre: (3,) centroid of the volume in the part frame [m]. Every symmetry keeps it in place.
    """

    name: str
    mesh: trimesh.Trimesh
    d_max: float
    symmetry: Symmetry
    centre: Floats

    @classmethod
    def from_mesh(cls, name: str, mesh: trimesh.Trimesh, symmetry: Symmetry | None = None) -> "PartModel":
        """Return the model of a watertight mesh [m], measuring ``d_max`` and ``centre``.

        Args:
            name: Catalogue name or file stem.
            mesh: Watertight triangle mesh in the part frame [m].
            symmetry: Symmetry group of the part; None for a part without symmetry.

        Raises:
            ValueError: The mesh is not watertight.
        """
        if not mesh.is_watertight:
            raise ValueError(f"the mesh of {name!r} must be watertight (every edge shared by two faces)")
        return cls(
            name=name,
            mesh=mesh,
            d_max=diameter(mesh.vertices),
            symmetry=symmetry or Symmetry(),
            centre=np.asarray(mesh.center_mass, dtype=np.float64),
        )


def diameter(points: Floats) -> float:
    """Return the largest distance between two of (N, 3) points, exactly; it lies between vertices of the hull."""
    hull = points[ConvexHull(points).vertices]
    if len(hull) <= 4000:
        return float(pdist(hull).max())
    blocks = [*range(0, len(hull), 1000), len(hull)]
    return float(max(np.linalg.norm(hull[a:b, None] - hull[None], axis=-1).max() for a, b in pairwise(blocks)))
