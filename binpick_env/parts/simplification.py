"""Fewer faces within a stated deviation, which is checked: simplifiers may lose walls, holes and bodies."""

import manifold3d
import numpy as np
import trimesh

from binpick_env.parts.surface import SurfaceProbe, farthest
from perception.winding import shells_of

_VOLUME = 0.02  # largest share of the volume that may be lost or gained


def simplified(mesh: trimesh.Trimesh, tolerance: float) -> trimesh.Trimesh | None:
    """Return a mesh of fewer faces within ``tolerance`` [m] of a watertight one, or None if there is none.

    Smaller tolerances are tried, too, since a wall vanishes that is thinner than three of them.
    The result is watertight, has as many closed surfaces, and encloses the same volume within 2 %. Its metadata holds
    the measured ``deviation`` [m], the Hausdorff distance over all vertices and 4000 points of each surface.

    Note:
        A mesh of two million faces takes half a minute to load, and 2.6 GB of memory.
    """
    scale = float(mesh.scale)  # single precision suffices in units of the part
    origin = mesh.bounds.mean(axis=0)
    solid = to_manifold(mesh.vertices - origin, mesh.faces, scale)
    if solid is None:
        return None
    shells, probe = len(shells_of(mesh)), None
    for part in (1.0, 0.5, 0.25, 0.125, 0.0625):
        coarse = _collapsed(solid, part * tolerance, scale, origin)
        if (
            coarse is None
            or abs(coarse.volume - mesh.volume) > _VOLUME * mesh.volume
            or len(shells_of(coarse)) != shells
        ):
            continue
        lost = farthest(mesh, SurfaceProbe(coarse, samples=1))
        if lost > tolerance:
            continue
        probe = probe or SurfaceProbe(mesh, samples=1)  # prepared once: the slow step for a mesh of many faces
        deviation = max(lost, farthest(coarse, probe))
        if deviation <= tolerance:
            coarse.metadata["deviation"] = deviation
            return coarse
    return None


def _collapsed(
    solid: manifold3d.Manifold, tolerance: float, scale: float, origin: np.ndarray
) -> trimesh.Trimesh | None:
    """Return a solid's mesh [m] with short edges collapsed by manifold3d; None if the result is no closed surface."""
    coarse = from_manifold(solid.simplify(tolerance / scale), scale)
    coarse.apply_translation(origin)
    return coarse if len(coarse.faces) and coarse.is_watertight else None


def to_manifold(vertices: np.ndarray, faces: np.ndarray, scale: float = 1.0) -> manifold3d.Manifold | None:
    """Return manifold3d's solid of a closed mesh whose vertices are divided by ``scale``; None if it refuses it."""
    mesh = manifold3d.Mesh64(np.asarray(vertices, np.float64) / scale, np.asarray(faces, np.uint64))
    solid = manifold3d.Manifold(mesh)
    return solid if solid.status() == manifold3d.Error.NoError and not solid.is_empty() else None


def from_manifold(solid: manifold3d.Manifold, scale: float = 1.0) -> trimesh.Trimesh:
    """Return the mesh of manifold3d's solid, its vertices multiplied by ``scale``."""
    mesh = solid.to_mesh64()
    vertices = np.asarray(mesh.vert_properties, np.float64)[:, :3] * scale
    return trimesh.Trimesh(vertices, np.asarray(mesh.tri_verts, np.int64), process=False)
