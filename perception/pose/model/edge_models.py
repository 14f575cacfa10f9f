"""Multiple edge appearance models: the edge points of a part and the viewpoints from which each is seen.

Reconstructed from the abstract of Liu et al., "PPF-MEAM", Sensors 18 (2018). Edges that are never seen together must
not vote together, so that each edge point knows its views; one list holds the points of all views.
"""

from collections.abc import Iterator
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

_VERSION = 1  # of what is stored: raise it whenever the same part and settings give other points
_WINDOW = 0.05  # of d_max: over which a curved silhouette has its direction, that of tangents in a scene (0.05 to 0.08)
_SAMPLES = 5  # along one thinning distance: kept points are at most 1.2 of it apart on a straight edge


@dataclass(frozen=True, eq=False, kw_only=True)
class EdgeModel:
    """What the edges of a part look like from V viewpoints.

    Attributes:
        points: (M, 3) float64 on the mesh, part frame [m].
        tangents: (M, 3) float64 unit direction of the edge, sign arbitrary.
        visibility: (M,) uint32, bit v set where view v sees the point as an edge and no other stands for it.
        views: (V, 3) float64 unit directions from the centre to the camera, part frame.
        centre: (3,) the part's centre, part frame [m].
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
        """Return the (...) view nearest to (..., 3) directions towards the camera, which need not be unit.

        Of equally near views the first is taken.
        """
        direction = np.asarray(direction_part, dtype=np.float64)
        if direction.ndim == 0 or direction.shape[-1] != 3:
            raise ValueError(f"direction_part must be (..., 3), got {direction.shape}")
        if not np.isfinite(direction).all() or not direction.any(axis=-1).all():
            raise ValueError("direction_part must be finite and not zero")
        nearest: Ints = np.asarray(np.argmax(direction @ self.views.T, axis=-1), dtype=np.int64)
        return nearest

    def visible_in(self, view: int) -> Bools:
        """Return the (M,) mask of the edge points of one view."""
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
    """What counts as an edge and how densely edges are sampled; lengths are in units of the part's ``d_max``."""

    views: ViewCount = 14  # cube faces (6, as in the paper), with corners (14), with edges (26)
    distance: float = 10.0  # of the camera from the part's centre; inf for parallel rays
    crease: float = float(np.deg2rad(30))  # angle between two normals that shading shows as an edge [rad]
    depth_jump: float = 0.02  # step of depth that is an edge
    inset: float = 0.015  # of points from a curved silhouette: beside it, depth is lost to grazing and the nearer taken
    thinning: float = 0.025  # distance under which parallel edge points are one; wider than fillets
    thinning_angle: float = float(np.deg2rad(30))  # angle between tangents above which points are not merged [rad]

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
    """Return the part's edge points, thinned, with the views that see them.

    A point stands for a view that sees it unless another one near it, with nearly the same tangent, does so already:
    within every view parallel edges closer than the thinning are one line, and each bit holds for the point's exact
    place. Edges of opposite sides of a thin plate, which no view sees together, stay apart.

    Args:
        part: Its mesh must enclose a volume.
        config: :class:`EdgeModelConfig`'s defaults if left out.

    Raises:
        ValueError: If the mesh is empty, open or turned inside out.

    Note:
        Deterministic. Kept in the cache folder under a hash of mesh and settings; the first call takes 0.1 s
        for a mesh of 2000 faces and 14 views.
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
    """Return the hash of all that the edges of a part depend on.

    Raises:
        ValueError: If the mesh is empty, open or turned inside out.
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
    """Yield for each of (V, 3) unit directions the samples that it sees, and their points and tangents in it.

    Samples are ``config.thinning / 5`` apart and numbered alike in all views; directions point towards the camera.
    """
    samples = sample_edges(part.mesh, config.crease, config.thinning * part.d_max / _SAMPLES)
    limits = EdgeLimits(crease=config.crease, depth_jump=config.depth_jump * part.d_max, diameter=part.d_max)
    creases = np.nonzero(samples.crease)[0]
    tangents = samples.tangents.copy()
    tangents[creases] = chain_tangents(samples, creases, config.thinning * part.d_max)
    for direction in directions:
        eye = _eye(part, direction, config.distance)
        seen = seen_edges(part.mesh, samples, eye, limits)
        smooth = ~samples.crease[seen]
        points_seen, tangents_seen = samples.points[seen], tangents[seen]
        points_seen[smooth] = inset_points(part.mesh, samples, seen[smooth], eye, config.inset * part.d_max, part.d_max)
        tangents_seen[smooth] = chain_tangents(samples, seen[smooth], _WINDOW * part.d_max)
        yield seen, points_seen, tangents_seen


def _eye(part: PartModel, direction: Floats, distance: float) -> Floats:
    if np.isinf(distance):
        return np.append(direction, 0.0)
    return np.append(part.centre + distance * part.d_max * direction, 1.0)


def _merge_views(
    views: list[tuple[Ints, Floats, Floats]], distance: float, angle: float
) -> tuple[Floats, Floats, Masks]:
    """Return points, tangents and view bits; a sample that looks different to another view comes more than once."""
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
    """Return the (N,) masks of the points that stay, with 0 where a point is left out.

    The points that most views see come first; each keeps the views that see no earlier point within ``radius`` [m]
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
