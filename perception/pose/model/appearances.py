"""Edge appearances: the edge points of a part seen from each of some hundreds of directions.

The few views of an :class:`~perception.pose.model.edge_models.EdgeModel` decide which edges may vote together. They are
too coarse to refine or verify a pose, because between two of them curved silhouettes move and edges appear or vanish.
Here every direction is within about 5 deg of a computed one.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np
import trimesh
from numpy.typing import NDArray

from perception.geometry import Floats, require_shape
from perception.part import PartModel
from perception.pose.model._pair_kernels import tangent_frames
from perception.pose.model.edge_models import EdgeModelConfig, edges_key, view_of_edges
from perception.pose.model.thinning import thin_points
from perception.runtime.cache import Arrays, cached_arrays
from perception.runtime.threads import in_threads

_VERSION = 2  # of the stored arrays; raise it when the same part and settings give other points
SUBDIVISIONS = 3  # of the icosahedron whose corners are the directions: 642 of them
_CELL = 0.01  # share of d_max; pixel in which a view's edges are counted, so that parallel ones merge as in an image


class SeenEdges(Protocol):
    """Edges of a part by direction of view; :class:`EdgeAppearances` and ``EdgeModel`` are such."""

    @property
    def centre(self) -> Floats:
        """(3,) centre of the part, part frame [m]."""
        ...

    @property
    def d_max(self) -> float:
        """Diameter of the part [m]."""
        ...

    def seen_from(self, direction_part: Floats) -> tuple[Floats, Floats]:
        """Return (S, 3) edge points [m] and (S, 3) unit tangents in the part frame, seen from a (3,) direction."""
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class EdgeAppearances:
    """Edge points of a part, view by view.

    Attributes:
        views: (V, 3) float64 unit directions from the part's centre to the camera, part frame.
        starts: (V + 1,) int64 index of each view's first point; those of view v end before ``starts[v + 1]``.
        lengths: (V,) total length of each view's edges as drawn in an image, at the part's distance [m].
        points: (E, 3) float64 edge points on the mesh, part frame [m].
        tangents: (E, 3) float64 unit tangents of the edges, sign arbitrary.
        centre: (3,) centre of the part, part frame [m].
        d_max: Largest distance between two vertices of the part [m].
    """

    views: Floats
    starts: NDArray[np.int64]
    lengths: Floats
    points: Floats
    tangents: Floats
    centre: Floats
    d_max: float

    def __post_init__(self) -> None:
        require_shape("views", self.views, (None, 3))
        require_shape("starts", self.starts, (len(self.views) + 1,))
        require_shape("lengths", self.lengths, (len(self.views),))
        require_shape("points", self.points, (None, 3))
        require_shape("tangents", self.tangents, (len(self.points), 3))
        if len(self.views) == 0 or self.starts[0] != 0 or self.starts[-1] != len(self.points):
            raise ValueError(f"starts must run from 0 to {len(self.points)} over at least one view")

    def seen_from(self, direction_part: Floats) -> tuple[Floats, Floats]:
        """Return (S, 3) points and (S, 3) tangents of the view nearest to a (3,) direction towards the camera."""
        view = int(np.argmax(self.views @ direction_part))
        seen = slice(self.starts[view], self.starts[view + 1])
        return self.points[seen], self.tangents[seen]

    def every(self, step: int) -> "EdgeAppearances":
        """Return the same views with every ``step``-th of their points; ``lengths`` stay as they are.

        Raises:
            ValueError: ``step`` is not positive.
        """
        if step < 1:
            raise ValueError(f"step must be at least 1, got {step}")
        kept = [np.arange(first, last, step) for first, last in pairwise(self.starts.tolist())]
        chosen = np.concatenate(kept).astype(np.int64)
        starts = np.cumsum([0, *(len(k) for k in kept)])
        return replace(self, starts=starts, points=self.points[chosen], tangents=self.tangents[chosen])

    def expected_points(self, K: Floats, depth: float) -> int:
        """Return P of the paper: the number of boundary pixels of the part's largest view.

        Args:
            K: (3, 3) camera matrix [px]; its horizontal focal length sets the scale.
            depth: Distance of the part from the camera [m].

        Raises:
            ValueError: ``depth`` is not positive.
        """
        if not 0 < depth < np.inf:
            raise ValueError(f"depth must be positive, got {depth}")
        return round(float(self.lengths.max()) * float(K[0, 0]) / depth)


def edge_appearances(
    part: PartModel, config: EdgeModelConfig | None = None, subdivisions: int = SUBDIVISIONS
) -> EdgeAppearances:
    """Return a part's edge points seen from all directions.

    Args:
        part: Part whose edges are searched for; its mesh must enclose a volume.
        config: Definition of an edge, without its number of views; the defaults of :class:`EdgeModelConfig` if None.
        subdivisions: Number of subdivisions of the icosahedron whose corners are the directions; 2 gives 162, 3 gives
            642.

    Raises:
        ValueError: The mesh is empty, open or turned inside out.

    Note:
        Deterministic. The result is kept in the cache folder; the first call takes some seconds.
    """
    config = config or EdgeModelConfig()
    key = edges_key(part, config, _VERSION) + f"-{subdivisions}"
    arrays = cached_arrays("appearances", key, lambda: _compute(part, config, subdivisions))
    return EdgeAppearances(
        views=arrays["views"],
        starts=arrays["starts"],
        lengths=arrays["lengths"],
        points=arrays["points"],
        tangents=arrays["tangents"],
        centre=np.asarray(part.centre, dtype=np.float64),
        d_max=part.d_max,
    )


def _compute(part: PartModel, config: EdgeModelConfig, subdivisions: int) -> Arrays:
    views = np.asarray(trimesh.creation.icosphere(subdivisions).vertices, dtype=np.float64)
    views = views / np.linalg.norm(views, axis=1, keepdims=True)
    radius = config.thinning * part.d_max
    see = view_of_edges(part, config)

    def appearance(direction: Floats) -> tuple[Floats, Floats, float]:
        _, seen, along = see(direction)
        kept = thin_points(seen, along, radius, config.thinning_angle)
        return seen[kept], along[kept], _drawn_length(seen, along, direction, _CELL * part.d_max)

    # The first view fills the mesh's lazy caches, which several threads must not do at once.
    found = [appearance(views[0]), *in_threads(appearance, views[1:])]
    return {
        "views": views,
        "starts": np.cumsum([0, *(len(points) for points, _, _ in found)]),
        "lengths": np.array([length for _, _, length in found]),
        "points": np.concatenate([points for points, _, _ in found]),
        "tangents": np.concatenate([tangents for _, tangents, _ in found]),
    }


def _drawn_length(points: Floats, tangents: Floats, direction: Floats, cell: float) -> float:
    """Return the number of pixels that (S, 3) edge points cover as 8-connected lines, times their side ``cell`` [m]."""
    across = tangent_frames(direction[None])[0, 1:]
    places, slopes = points @ across.T / cell, tangents @ across.T
    # A line has one pixel in each column, or in each row if it is steep: the pixel where it crosses the middle.
    rows = np.arange(len(points))
    major = np.argmax(np.abs(slopes), axis=1)
    pixels = np.round(places)
    run = slopes[rows, major]
    slope = np.divide(slopes[rows, 1 - major], run, out=np.zeros(len(rows)), where=np.abs(run) > 1e-12)
    ahead = pixels[rows, major] - places[rows, major]
    pixels[rows, 1 - major] = np.round(places[rows, 1 - major] + slope * ahead)
    return cell * len(np.unique(pixels, axis=0))
