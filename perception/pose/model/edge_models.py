"""Multiple edge appearance models: the edge points of a part, and the views that each of them is visible in.

Reconstructed from the abstract of Liu et al., "PPF-MEAM", Sensors 18 (2018). Edges that are never visible together must
not vote together. So one list holds the points of all views, with the views of each point.
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from perception.geometry import Floats, require_shape
from perception.part import PartModel
from perception.pose.model.mesh_edges import (
    Bools,
    EdgeLimits,
    Ints,
    chain_tangents,
    inset_points,
    sample_edges,
    seen_edges,
)
from perception.pose.model.viewpoints import VIEW_COUNTS, ViewCount, view_directions
from perception.runtime.cache import Arrays, cached_arrays, digest

Masks = NDArray[np.uint32]

_VERSION = 1  # of the stored arrays; raise it when the same part and settings give other points
_WINDOW = 0.05  # share of d_max over which the tangent of a curved silhouette is fitted; 0.05 to 0.08 in scenes
_SAMPLES = 5  # per thinning distance; kept points on a straight edge are at most 1.2 thinning distances apart


@dataclass(frozen=True, eq=False, kw_only=True)
class EdgeModel:
    """Edge points of a part, and the views that each of them is visible in.

    Attributes:
        points: (M, 3) float64 edge points on the mesh, part frame [m].
        tangents: (M, 3) float64 unit tangents of the edges, sign arbitrary.
        visibility: (M,) uint32, bit v set where view v sees the point as an edge and no other point represents it.
        views: (V, 3) float64 unit directions from the part's centre to the camera, part frame.
        centre: (3,) centre of the part, part frame [m].
        d_max: Largest distance between two vertices of the part [m].
    """

    points: Floats
    tangents: Floats
    visibility: Masks
    views: Floats
    centre: Floats
    d_max: float

    def __post_init__(self) -> None:
        require_shape("points", self.points, (None, 3))
        require_shape("tangents", self.tangents, (len(self.points), 3))
        require_shape("visibility", self.visibility, (len(self.points),))
        require_shape("views", self.views, (None, 3))
        require_shape("centre", self.centre, (3,))
        if self.visibility.dtype != np.uint32:
            raise ValueError(f"visibility must be uint32, got {self.visibility.dtype}")
        if not 1 <= len(self.views) <= 32:
            raise ValueError(f"views must be 1 to 32, a bit each, got {len(self.views)}")
        if not 0 < self.d_max < np.inf:
            raise ValueError(f"d_max must be positive, got {self.d_max}")

    def __len__(self) -> int:
        return len(self.points)

    def nearest_view(self, direction_part: ArrayLike) -> Ints:
        """Return the (...) indices of the views nearest to (..., 3) directions towards the camera, of any length.

        Of equally near views the first is taken.

        Raises:
            ValueError: A direction is zero, not finite or not of three numbers.
        """
        direction = np.asarray(direction_part, dtype=np.float64)
        if direction.ndim == 0 or direction.shape[-1] != 3:
            raise ValueError(f"direction_part must be (..., 3), got {direction.shape}")
        if not np.isfinite(direction).all() or not direction.any(axis=-1).all():
            raise ValueError("direction_part must be finite and not zero")
        nearest: Ints = np.asarray(np.argmax(direction @ self.views.T, axis=-1), dtype=np.int64)
        return nearest

    def visible_in(self, view: int) -> Bools:
        """Return the (M,) mask of the edge points of one view.

        Raises:
            ValueError: There is no view of this index.
        """
        if not 0 <= view < len(self.views):
            raise ValueError(f"view must be in 0 to {len(self.views) - 1}, got {view}")
        visible: Bools = (self.visibility >> np.uint32(view)) & np.uint32(1) == 1
        return visible

    def seen_from(self, direction_part: ArrayLike) -> tuple[Floats, Floats]:
        """Return (S, 3) points and (S, 3) tangents of the view nearest to a (3,) direction towards the camera."""
        seen = self.visible_from(direction_part)
        return self.points[seen], self.tangents[seen]

    def visible_from(self, direction_part: ArrayLike) -> Bools:
        """Return the (M,) mask of the edge points of the view nearest to a (3,) direction towards the camera."""
        require_shape("direction_part", np.asarray(direction_part), (3,))
        return self.visible_in(int(self.nearest_view(direction_part)))


@dataclass(frozen=True, kw_only=True)
class EdgeModelConfig:
    """Definition of an edge, and density of the edge points.

    Attributes:
        views: Number of views: the faces of a cube (6, as in the paper), with its corners (14), with its edges (26).
        distance: Distance of the camera from the part's centre, as a share of d_max; infinite for parallel rays.
        crease: Angle between two normals above which shading shows an edge [rad].
        depth_jump: Step in depth that is an edge, as a share of d_max.
        inset: Distance of edge points from a curved silhouette, towards the surface, as a share of d_max. At
            the silhouette depth is lost to grazing incidence, and a boundary point has the nearest depth inside.
        thinning: Distance below which parallel edge points are merged, as a share of d_max; wider than fillets.
        thinning_angle: Angle between tangents above which edge points are not merged [rad].
    """

    views: ViewCount = 14
    distance: float = 10.0
    crease: float = float(np.deg2rad(30))
    depth_jump: float = 0.02
    inset: float = 0.015
    thinning: float = 0.025
    thinning_angle: float = float(np.deg2rad(30))

    def __post_init__(self) -> None:
        if self.views not in VIEW_COUNTS:
            raise ValueError(f"views must be one of {list(VIEW_COUNTS)}, got {self.views}")
        if not self.distance > 1:
            raise ValueError(f"distance must be more than 1 d_max (outside the part), got {self.distance}")
        for name in ("crease", "thinning_angle"):
            if not 0 < getattr(self, name) <= np.pi / 2:
                raise ValueError(f"{name} must be in (0, pi/2] rad, got {getattr(self, name)}")
        if not 0 < self.depth_jump < 1:
            raise ValueError(f"depth_jump must be between 0 and 1 d_max, got {self.depth_jump}")
        if not 0 <= self.inset < 0.1:
            raise ValueError(f"inset must be at least 0 and under 0.1 d_max, got {self.inset}")
        if not 0.001 <= self.thinning < 1:
            raise ValueError(f"thinning must be at least 0.001 and under 1 d_max, got {self.thinning}")


def edge_model(part: PartModel, config: EdgeModelConfig | None = None) -> EdgeModel:
    """Return the thinned edge points of a part with the views that each is visible in.

    A point represents a view that sees it, unless another point near it with nearly the same tangent does so already.
    So parallel edges closer than the thinning become one line in each view, and every bit holds for the exact place of
    its point. Edges on opposite sides of a thin plate, which no view sees together, stay apart.

    Args:
        part: Part whose edges are searched for; its mesh must enclose a volume.
        config: Definition of an edge; the defaults of :class:`EdgeModelConfig` if None.

    Raises:
        ValueError: The mesh is empty, open or turned inside out.

    Note:
        Deterministic. The result is kept in the cache folder under a hash of mesh and settings. The first call takes
        0.1 s for a mesh of 2000 faces and 14 views.
    """
    config = config or EdgeModelConfig()
    arrays = cached_arrays("edges", edges_key(part, config, _VERSION), lambda: _compute(part, config))
    return EdgeModel(
        points=arrays["points"],
        tangents=arrays["tangents"],
        visibility=arrays["visibility"],
        views=view_directions(config.views),
        centre=np.asarray(part.centre, dtype=np.float64),
        d_max=part.d_max,
    )


def edges_key(part: PartModel, config: EdgeModelConfig, version: int) -> str:
    """Return the hash of everything that the edges of a part depend on.

    Raises:
        ValueError: The mesh is empty, open or turned inside out.
    """
    mesh = part.mesh
    if len(mesh.faces) == 0 or not mesh.is_volume:
        raise ValueError(f"the mesh of {part.name!r} must enclose a volume (watertight, normals outwards)")
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    return digest(version, vertices, faces, part.d_max, np.asarray(part.centre), asdict(config))


def _compute(part: PartModel, config: EdgeModelConfig) -> Arrays:
    radius = config.thinning * part.d_max
    views = list(edges_by_view(part, view_directions(config.views), config))
    points, tangents, masks = _merge_views(views, radius / _SAMPLES, config.thinning_angle / 3)
    masks = thin(points, tangents, masks, radius, config.thinning_angle)
    kept = masks > 0
    return {"points": points[kept], "tangents": tangents[kept], "visibility": masks[kept]}


def edges_by_view(
    part: PartModel, directions: Floats, config: EdgeModelConfig
) -> Iterator[tuple[Ints, Floats, Floats]]:
    """Yield what :func:`view_of_edges` returns for each of (V, 3) directions from the part's centre to the camera."""
    yield from map(view_of_edges(part, config), directions)


def view_of_edges(part: PartModel, config: EdgeModelConfig) -> Callable[[Floats], tuple[Ints, Floats, Floats]]:
    """Return a function that returns the visible samples of a view, with their points and tangents in this view.

    Samples are at most ``config.thinning / 5`` apart, and each has the same index in all views.

    Args:
        part: Part whose edges are sampled.
        config: Definition of an edge.

    Returns:
        A function of a (3,) unit direction from the part's centre to the camera. It returns the (S,) indices of the
        samples, their (S, 3) points [m] and their (S, 3) unit tangents, part frame. Several threads may call it.
    """
    samples = sample_edges(part.mesh, config.crease, config.thinning * part.d_max / _SAMPLES)
    limits = EdgeLimits(crease=config.crease, depth_jump=config.depth_jump * part.d_max, diameter=part.d_max)
    creases = np.nonzero(samples.crease)[0]
    tangents = samples.tangents.copy()
    tangents[creases] = chain_tangents(samples, creases, config.thinning * part.d_max)

    def see(direction: Floats) -> tuple[Ints, Floats, Floats]:
        eye = _eye(part, direction, config.distance)
        seen = seen_edges(part.mesh, samples, eye, limits)
        smooth = ~samples.crease[seen]
        points_seen, tangents_seen = samples.points[seen], tangents[seen]
        points_seen[smooth] = inset_points(part.mesh, samples, seen[smooth], eye, config.inset * part.d_max, part.d_max)
        tangents_seen[smooth] = chain_tangents(samples, seen[smooth], _WINDOW * part.d_max)
        return seen, points_seen, tangents_seen

    return see


def _eye(part: PartModel, direction: Floats, distance: float) -> Floats:
    if np.isinf(distance):
        return np.append(direction, 0.0)
    return np.append(part.centre + distance * part.d_max * direction, 1.0)


def _merge_views(
    views: list[tuple[Ints, Floats, Floats]], distance: float, angle: float
) -> tuple[Floats, Floats, Masks]:
    """Return points, tangents and view bits; a sample whose point or tangent differs between views comes repeatedly."""
    count = max((int(seen.max(initial=-1)) + 1 for seen, _, _ in views), default=0)
    latest = np.full(count, -1, dtype=np.int64)
    points, tangents = np.zeros((0, 3)), np.zeros((0, 3))
    masks = np.zeros(0, dtype=np.uint32)
    for view, (seen, points_seen, tangents_seen) in enumerate(views):
        bit = np.uint32(1 << view)
        known = np.nonzero(latest[seen] >= 0)[0]
        before = latest[seen[known]]
        near = np.linalg.norm(points[before] - points_seen[known], axis=1) <= distance
        cosine = np.abs(np.einsum("ci,ci->c", tangents[before], tangents_seen[known]))
        alike = near & (cosine >= np.cos(angle))
        masks[before[alike]] |= bit
        new = np.setdiff1d(np.arange(len(seen)), known[alike])
        latest[seen[new]] = len(points) + np.arange(len(new))
        points, tangents = np.concatenate([points, points_seen[new]]), np.concatenate([tangents, tangents_seen[new]])
        masks = np.append(masks, np.full(len(new), bit))
    return points, tangents, masks


def thin(points: Floats, tangents: Floats, masks: Masks, radius: float, angle: float) -> Masks:
    """Return the (N,) view bits that remain of the points, 0 for a point that is left out.

    The points that most views see come first. Each keeps the views that see no earlier point within ``radius`` [m]
    whose tangent differs by at most ``angle`` [rad].
    """
    pairs = cKDTree(points).query_pairs(radius, output_type="ndarray") if len(points) else np.zeros((0, 2), np.int64)
    cosine = np.abs(np.einsum("ci,ci->c", tangents[pairs[:, 0]], tangents[pairs[:, 1]]))
    pairs = pairs[cosine >= np.cos(angle)]
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    first = np.searchsorted(both[:, 0], np.arange(len(points) + 1))
    free = masks.copy()
    for index in np.argsort(-np.bitwise_count(masks).astype(np.int64), kind="stable"):
        free[both[first[index] : first[index + 1], 1]] &= ~free[index]
    return free
