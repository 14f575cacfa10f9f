"""Convex pieces for the physics, found by CoACD and kept on disk.

MuJoCo collides convex meshes only. A part from a file is decomposed once, which takes seconds to a minute, and its
pieces are cached in the user's cache folder under a hash of everything they depend on. The catalogue needs none of
this: its parts are drawn as unions of convex bodies. (Measured on its hollow tee: CoACD cut 36 to 80 pieces in 50 s or
more, with a quarter of false volume left; the drawing has 5 bodies, exact outside.)
"""

import logging
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from binpick_env.parts.decomposition import decompose
from binpick_env.parts.hull import distance_outside, is_nearly_convex, thinned_hull
from binpick_env.parts.simplification import simplified
from perception.geometry import Floats
from perception.runtime.cache import Arrays, cached_arrays, digest

log = logging.getLogger(__name__)
_MANY_FACES = 2000  # number of faces above which a mesh is simplified before it is cut: CoACD takes 1.5 ms a face
_TOLERANCE = 0.01  # largest deviation of the simplified mesh and of its pieces, as a share of the largest extent
_TIMEOUT = 120.0  # time after which a cut without remeshing is given up [s]; it takes seconds
Pieces = tuple[trimesh.Trimesh, ...]


@dataclass(frozen=True, kw_only=True)
class PieceSettings:
    """How finely a mesh is cut. Every contact pair costs time for each of 25 parts: a few coarse pieces pay off."""

    threshold: float = 0.08  # concavity left in a piece, CoACD's measure on the mesh scaled to [-1, 1]
    max_pieces: int = 16  # largest number of pieces, to which CoACD merges them
    max_vertices: int = 64  # largest number of vertices of a piece's hull
    iterations: int = 60  # iterations of the tree search for each cut; CoACD's own 150 took twice as long, no better
    resolution: int = 1000  # surface samples of the concavity measure
    seed: int = 0  # seed of CoACD

    def __post_init__(self) -> None:
        if not 0.01 <= self.threshold <= 1:
            raise ValueError(f"threshold must be in [0.01, 1], got {self.threshold}")
        for name, least in (("max_pieces", 1), ("max_vertices", 8), ("iterations", 1), ("resolution", 100)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be at least {least}, got {getattr(self, name)}")


def convex_pieces(mesh: trimesh.Trimesh, settings: PieceSettings | None = None) -> Pieces:
    """Cover ``mesh`` with convex pieces.

    Args:
        mesh: Watertight mesh, part frame [m].
        settings: Accuracy and number of the pieces.

    Returns:
        Convex watertight meshes in the same frame, largest first.

    Raises:
        ValueError: CoACD finds no piece, or its process ends without a result.

    Note:
        Deterministic. The first call for a mesh takes seconds (a hollow pipe: half a minute), later ones milliseconds.
        A convex mesh is its own piece. Hulls of more than ``max_vertices`` are thinned and keep their volume.
        A cache that cannot be read or written costs a warning and time, never the result.
    """
    settings = settings or PieceSettings()

    def compute() -> Arrays:
        return _packed(_compute(mesh, settings))

    content = (np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64))
    edition = "v2" if len(mesh.faces) <= _MANY_FACES else "v3"
    key = digest(edition, version("coacd"), sorted(asdict(settings).items()), *content)
    return _unpacked(cached_arrays("pieces", key, compute))


def _compute(mesh: trimesh.Trimesh, settings: PieceSettings) -> Pieces:
    """Return the convex pieces of a mesh: itself if it is convex, or else what CoACD finds."""
    if is_nearly_convex(mesh):
        return (thinned_hull(np.asarray(mesh.vertices, np.float64), settings.max_vertices),)
    hulls = _cut(mesh, settings)
    least = 1e-6 * float(np.prod(mesh.extents))  # smaller hulls are slivers of the cuts and carry no contact
    solid = [
        vertices for vertices in hulls if len(vertices) >= 4 and np.linalg.matrix_rank(vertices - vertices[0]) == 3
    ]
    pieces = [thinned_hull(vertices, settings.max_vertices) for vertices in solid]
    pieces = sorted((piece for piece in pieces if piece.volume > least), key=lambda piece: -piece.volume)
    if not pieces:
        raise ValueError(f"CoACD found no convex piece in a mesh of {len(mesh.faces)} faces and {mesh.volume:.3g} m^3")
    log.info("the part has %d convex pieces", len(pieces))
    return tuple(pieces)


def _cut(mesh: trimesh.Trimesh, settings: PieceSettings) -> list[Floats]:
    """Return the vertices of each convex piece that CoACD finds, in a simplified mesh if there are many faces."""
    arguments: dict[str, float | str] = {
        "threshold": settings.threshold,
        "max_convex_hull": settings.max_pieces,
        "mcts_iterations": settings.iterations,
        "resolution": settings.resolution,
        "seed": settings.seed,
    }
    tolerance = _TOLERANCE * float(np.linalg.norm(mesh.extents))
    coarse = simplified(mesh, tolerance) if len(mesh.faces) > _MANY_FACES else None
    if coarse is None:
        log.info("cutting a mesh of %d faces into convex pieces; this is done once", len(mesh.faces))
        return decompose(mesh, arguments)
    log.info(
        "%d faces were simplified to %d, which deviate by at most %.2f mm and are cut into convex pieces; once",
        len(mesh.faces),
        len(coarse.faces),
        1e3 * coarse.metadata["deviation"],
    )
    arguments["mcts_iterations"] = max(1, settings.iterations // 3)  # cuts need not be finer than the mesh
    hulls = _cut_as_it_is(coarse, {**arguments, "resolution": max(100, settings.resolution // 3)})
    missed = distance_outside(np.asarray(mesh.vertices, np.float64), hulls)
    if missed <= tolerance:
        log.info("the pieces miss points of the part by at most %.2f mm", 1e3 * missed)
        return hulls
    log.info("the pieces miss points of the part by %.2f mm: the mesh is cut again, from voxels", 1e3 * missed)
    return decompose(coarse, arguments)


def _cut_as_it_is(mesh: trimesh.Trimesh, arguments: Mapping[str, float | str]) -> list[Floats]:
    """Cut a closed mesh without CoACD's remeshing; no pieces if that fails.

    CoACD finds that simplified meshes are no manifolds, and remeshes them from voxels. On an organic part that took
    seven times as long, and the pieces had 5.8 % more volume outside of the part in place of 2.6 %. Without it, thin
    slits may remain between the pieces inside of the part, 1.3 % of its volume there.
    """
    try:
        return decompose(mesh, {**arguments, "preprocess_mode": "off"}, timeout=_TIMEOUT)
    except ValueError as error:
        log.info("%s", error)
        return []


def _packed(pieces: Pieces) -> dict[str, NDArray[Any]]:
    return {
        "vertices": np.concatenate([np.asarray(piece.vertices) for piece in pieces]),
        "faces": np.concatenate([np.asarray(piece.faces) for piece in pieces]),
        "counts": np.array([(len(piece.vertices), len(piece.faces)) for piece in pieces]),
    }


def _unpacked(arrays: Arrays) -> Pieces:
    ends = np.cumsum(arrays["counts"], axis=0)[:-1]
    parts = zip(np.split(arrays["vertices"], ends[:, 0]), np.split(arrays["faces"], ends[:, 1]), strict=True)
    return tuple(trimesh.Trimesh(vertices, faces, process=False) for vertices, faces in parts)
