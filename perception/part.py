"""What perception knows of a part: mesh, exact diameter, symmetry group, centre."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from perception.geometry import Floats, as_floats, require_kind, require_shape, rotation_about, rotation_angle
from perception.size import require_size
from perception.winding import outward, signed_volume

_MOST_PAIRS = 4000  # corners of a hull up to which all distances are computed at once
_LEAST_THICKNESS = 1e-5  # share of the largest extent; mean thickness below which a mesh is a sheet
_SWEEPS = 4  # steps from a point to the one farthest from it
_ROUNDING = 1e-9  # share of the largest extent; far more than squared distances are rounded by


@dataclass(frozen=True, eq=False, kw_only=True)
class Symmetry:
    """The proper rotations about a part's centre that map its surface onto itself.

    The group is ``{R @ Rot(axis, t)}`` over ``rotations`` and, where there is an axis, every angle ``t``. A ball's
    group is every rotation.

    Attributes:
        rotations: (S, 3, 3) float64 rotations in part axes, the identity first.
        axis: (3,) unit axis of a solid of revolution in part axes; None for any other part.
        sphere: Whether the part is a ball, whose orientation is free. It has no other rotation and no axis.
    """

    rotations: Floats = field(default_factory=lambda: np.eye(3)[None])
    axis: Floats | None = None
    sphere: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "rotations", as_floats("rotations", self.rotations))
        if self.axis is not None:
            object.__setattr__(self, "axis", as_floats("axis", self.axis))
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
        if self.sphere and (self.axis is not None or len(self.rotations) > 1):
            raise ValueError("a ball's symmetry contains every rotation: name neither an axis nor rotations")

    @property
    def order(self) -> float:
        """Number of group elements; infinite for a solid of revolution and for a ball."""
        return np.inf if self.axis is not None or self.sphere else float(len(self.rotations))

    def elements(self, steps: int = 72) -> Floats:
        """Return the (M, 3, 3) group elements, the identity first.

        A continuous axis is sampled at ``steps`` equal angles. A ball gives ``steps`` evenly spread rotations.
        """
        if self.sphere:
            return _spread_rotations(steps)
        if self.axis is None:
            return self.rotations
        turns = np.stack([rotation_about(self.axis, 2 * np.pi * k / steps) for k in range(steps)])
        products: Floats = np.einsum("sij,tjk->stik", self.rotations, turns)
        return products.reshape(-1, 3, 3)

    def distance(self, rotation_a: Floats, rotation_b: Floats) -> float:
        """Return the smallest angle [rad] between two (3, 3) part rotations modulo the group."""
        if self.sphere:
            return 0.0
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

        Faces with inverted winding are turned, in a copy. A closed surface inside another one stays a cavity.

        Args:
            name: Catalogue name or file stem.
            mesh: Watertight triangle mesh in the part frame [m].
            symmetry: Symmetry group of the part; None for a part without symmetry.

        Raises:
            ValueError: The mesh is not watertight, encloses no volume, is no part's size in metres, or is none.
        """
        require_kind("mesh", mesh, trimesh.Trimesh, "binpick_env.parts.load_part reads files")
        if not (len(mesh.faces) and np.isfinite(mesh.vertices).all()):
            raise ValueError(f"the mesh of {name!r} must have faces and finite vertices")
        if not mesh.is_watertight:
            raise ValueError(f"the mesh of {name!r} must be watertight (every edge shared by two faces)")
        mesh = outward(mesh)
        require_volume(name, mesh)
        d_max = diameter(mesh.vertices)
        require_size(name, d_max)
        return cls(
            name=name,
            mesh=mesh,
            d_max=d_max,
            symmetry=symmetry or Symmetry(),
            centre=np.asarray(mesh.center_mass, dtype=np.float64),
        )


def require_volume(name: str, mesh: trimesh.Trimesh) -> None:
    """Refuse a mesh without a finite, positive volume and a centre inside its bounds.

    Args:
        name: Name of the part, for the message.
        mesh: Watertight mesh with normals outwards.

    Raises:
        ValueError: The mesh encloses no volume, as a sheet of two sides does.
    """
    volume, sheet = signed_volume(mesh), _LEAST_THICKNESS * float(np.linalg.norm(mesh.extents)) * float(mesh.area) / 2
    if not (np.isfinite(volume) and volume > sheet):
        raise ValueError(
            f"the mesh of {name!r} must enclose a volume, got {volume:.3g} m^3 within {mesh.area:.3g} m^2 of surface: "
            "a sheet needs a thickness"
        )
    low, high = mesh.bounds
    if not np.all((low <= mesh.center_mass) & (mesh.center_mass <= high)):
        raise ValueError(
            f"the centre of {name!r} must lie within its bounds, got {np.asarray(mesh.center_mass).tolist()}: its "
            "surfaces intersect or are inverted"
        )


def diameter(points: Floats) -> float:
    """Return the largest distance between two of (N, 3) points, exactly; it lies between vertices of the hull."""
    hull = _far_points(points[ConvexHull(points).vertices])
    if len(hull) <= _MOST_PAIRS:
        return float(pdist(hull).max())
    # Squared distances by matrix products, which are rounded, leave few pairs to measure exactly.
    offsets = hull - hull.mean(axis=0)
    squares = np.einsum("ni,ni->n", offsets, offsets)
    blocks = list(pairwise([*range(0, len(hull), 1000), len(hull)]))

    def block_squares(a: int, b: int) -> Floats:
        apart: Floats = squares[a:b, None] + squares - 2 * (offsets[a:b] @ offsets.T)
        return apart

    least = max(float(block_squares(a, b).max()) for a, b in blocks) - _ROUNDING * float(squares.max())
    largest = 0.0
    for a, b in blocks:
        first, second = np.nonzero(block_squares(a, b) >= least)
        if len(first):
            largest = max(largest, float(np.linalg.norm(hull[a + first] - hull[second], axis=-1).max()))
    return largest


def _far_points(points: Floats) -> Floats:
    """Return the points that may be an end of the largest distance: those far from the middle of a large one."""
    first = points[np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1))]
    for _ in range(_SWEEPS):
        second = points[np.argmax(np.linalg.norm(points - first, axis=1))]
        first, last = second, first
    apart = float(np.linalg.norm(first - last))
    away = np.linalg.norm(points - (first + last) / 2, axis=1)
    far: Floats = points[away + away.max() >= (1 - _ROUNDING) * apart]
    return far


def _spread_rotations(count: int) -> Floats:
    """Return (N, 3, 3) rotations spread evenly, the identity first: super-Fibonacci spirals (Alexa, CVPR 2022)."""
    k = np.arange(count) + 0.5
    r, R = np.sqrt(k / count), np.sqrt(1 - k / count)
    alpha, beta = 2 * np.pi * k / np.sqrt(2), 2 * np.pi * k / 1.533751168755204288118041
    quaternions = np.stack([r * np.sin(alpha), r * np.cos(alpha), R * np.sin(beta), R * np.cos(beta)], axis=1)
    rotations = Rotation.from_quat(quaternions)
    spread: Floats = (rotations[0].inv() * rotations).as_matrix()
    spread[0] = np.eye(3)
    return spread
