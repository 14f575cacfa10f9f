"""Convex pieces for the physics, found by CoACD and kept on disk.

MuJoCo collides convex meshes only. A part from a file is decomposed once, which takes seconds to a minute, and its
pieces are cached in the user's cache folder under a hash of everything they depend on. The catalogue needs none of
this: its parts are drawn as unions of convex bodies. (Measured on its hollow tee: CoACD cut 36 to 80 pieces in 50 s or
more, with a quarter of false volume left; the drawing has 5 bodies, exact outside.)
"""

import logging
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from perception.runtime.cache import Arrays, cached_arrays, digest

log = logging.getLogger(__name__)
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
        ValueError: CoACD finds no piece.

    Note:
        Deterministic. The first call for a mesh takes seconds (a hollow pipe: half a minute), later ones milliseconds.
        A cache that cannot be read or written costs a warning and time, never the result.
    """
    settings = settings or PieceSettings()

    def compute() -> Arrays:
        return _packed(_decompose(mesh, settings))

    content = (np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64))
    key = digest("v1", version("coacd"), sorted(asdict(settings).items()), *content)
    return _unpacked(cached_arrays("pieces", key, compute))


def _decompose(mesh: trimesh.Trimesh, settings: PieceSettings) -> Pieces:
    import coacd  # here, since it loads a library of 10 MB that cached parts never need

    log.info("cutting a mesh of %d faces into convex pieces; this is done once", len(mesh.faces))
    coacd.set_log_level("off")
    as_coacd: Callable[..., Any] = coacd.Mesh  # untyped there
    found = coacd.run_coacd(
        as_coacd(mesh.vertices, mesh.faces),
        threshold=settings.threshold,
        max_convex_hull=settings.max_pieces,
        decimate=True,
        max_ch_vertex=settings.max_vertices,
        mcts_iterations=settings.iterations,
        resolution=settings.resolution,
        seed=settings.seed,
    )
    least = 1e-6 * float(np.prod(mesh.extents))  # smaller hulls are slivers of the cuts and carry no contact
    hulls = [trimesh.convex.convex_hull(vertices) for vertices, _ in found if len(vertices) >= 4]
    pieces = sorted((hull for hull in hulls if hull.volume > least), key=lambda hull: -hull.volume)
    if not pieces:
        raise ValueError(f"CoACD found no convex piece in a mesh of {len(mesh.faces)} faces and {mesh.volume:.3g} m^3")
    return tuple(pieces)


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
