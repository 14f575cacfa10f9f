"""Solids of parts: overlap of two posed parts, and protrusion through the floor or the walls of a bin."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from perception.frame import Workspace
from perception.geometry import Floats, require_shape, transform_points
from perception.part import PartModel
from perception.pose.model.surface_models import SurfaceModel
from perception.pose.selection._body_kernels import samples_shared
from perception.runtime.cache import Arrays, cached_arrays, digest

_VERSION = 2  # of the stored arrays; raise it when the same part gives another grid
_CELLS = 80  # cells of the grid along d_max
_SAMPLES = 512  # points of the surface that are tested for lying inside another part


@dataclass(frozen=True, kw_only=True)
class BodyConfig:
    """Tolerances for collisions; even right poses are inexact, so that a little overlap is tolerated.

    Attributes:
        depth: Depth below one part's surface from which a point of another part lies inside it, as a share of d_max.
        overlap: Share of both surfaces inside the other part above which two parts collide.
        protrusion: Distance through the floor or a wall that is tolerated, as a share of d_max.
    """

    depth: float = 0.01
    overlap: float = 0.005
    protrusion: float = 0.05

    def __post_init__(self) -> None:
        for name in ("depth", "overlap", "protrusion"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(f"{name} must be in [0, 1), got {getattr(self, name)}")


@dataclass(frozen=True, eq=False, kw_only=True)
class BodyModel:
    """A part as a solid.

    Attributes:
        samples: (M, 3) points spread over the part's surface, part frame [m].
        corners: (H, 3) corners of the part's convex hull, part frame [m].
        inside: (X, Y, Z) float32 depth below the part's surface at the points of a grid, negative outside [m].
        origin: (3,) first point of the grid, part frame [m].
        cell: Distance between neighbouring points of the grid [m].
        middle: (3,) centre of a ball that encloses the part, part frame [m].
        radius: Radius of this ball [m].
    """

    samples: Floats
    corners: Floats
    inside: NDArray[np.float32]
    origin: Floats
    cell: float
    middle: Floats
    radius: float

    def __post_init__(self) -> None:
        require_shape("samples", self.samples, (None, 3))
        require_shape("corners", self.corners, (None, 3))
        require_shape("inside", self.inside, (None, None, None))

    def overlap(self, T_cam_a: Floats, T_cam_b: Floats, depth: float) -> float:
        """Return the share of both surfaces that lies inside the other part, in [0, 1].

        Args:
            T_cam_a: (4, 4) pose of the one part in the camera frame.
            T_cam_b: (4, 4) pose of the other one.
            depth: Depth below a surface from which a point lies inside [m].
        """
        grid = (self.inside, self.origin, self.cell, depth)
        found = samples_shared(T_cam_a, T_cam_b, self.middle, self.radius, self.samples, *grid)
        return found / (2 * len(self.samples))

    def protrusion(self, T_world_part: Floats, workspace: Workspace) -> float:
        """Return how far a posed part reaches through the floor or, below the rim, a wall [m]; 0 if it does not."""
        return max(*self.protrusions(T_world_part, workspace), 0.0)

    def protrusions(self, T_world_part: Floats, workspace: Workspace) -> tuple[float, float]:
        """Return how far a posed part reaches through the floor, and through a wall [m]; negative within the bin."""
        corners_bin = workspace.to_bin(transform_points(T_world_part, self.corners))
        beyond = np.abs(corners_bin[:, :2]).max(axis=0, initial=0.0, where=corners_bin[:, 2:] < workspace.inner_size[2])
        walls = float((beyond - workspace.inner_size[:2] / 2).max())
        return -float(corners_bin[:, 2].min()), walls


def body_model(part: PartModel, surface: SurfaceModel) -> BodyModel:
    """Return the solid of a part.

    Args:
        part: Part whose mesh encloses a volume.
        surface: Samples of the same part's surface.

    Note:
        Deterministic. The grid is kept in the cache folder; the first call takes about a second.
    """
    mesh = part.mesh
    key = digest(_VERSION, _CELLS, np.asarray(mesh.vertices), np.asarray(mesh.faces), part.d_max)
    arrays = cached_arrays("body", key, lambda: _compute(part))
    corners = np.asarray(mesh.convex_hull.vertices, np.float64)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    spread = np.linspace(0, len(surface.points) - 1, min(_SAMPLES, len(surface.points))).round().astype(np.int64)
    return BodyModel(
        samples=np.ascontiguousarray(surface.points[spread]),
        corners=corners,
        inside=arrays["inside"],
        origin=arrays["origin"],
        cell=part.d_max / _CELLS,
        middle=middle,
        radius=float(np.linalg.norm(corners - middle, axis=1).max()),
    )


def _compute(part: PartModel) -> Arrays:
    cell = part.d_max / _CELLS
    low, high = part.mesh.bounds
    # Half a cell off the bounds, because it is ambiguous whether a point on a flat face lies inside.
    origin = np.asarray(low, np.float64) - 1.5 * cell
    shape = np.ceil((high - origin) / cell).astype(np.int64) + 3
    axes = [origin[k] + cell * np.arange(shape[k]) for k in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    within = np.asarray(part.mesh.contains(points)).reshape(shape)
    # The surface lies half a cell from the nearest grid points on either side.
    depth = distance_transform_edt(within) - 0.5
    height = distance_transform_edt(~within) - 0.5
    return {"inside": (cell * np.where(within, depth, -height)).astype(np.float32), "origin": origin}
