"""Fewer faces within a stated deviation, which is checked: simplifiers may lose walls, holes and bodies."""

import numpy as np
import trimesh

from binpick_env.parts.solids import Mesh, collapse
from binpick_env.parts.surface import SurfaceProbe, farthest
from perception.geometry import Floats
from perception.winding import shells_of

_VOLUME = 0.02  # largest share of the volume that may be lost or gained


def simplified(mesh: trimesh.Trimesh, tolerance: float) -> trimesh.Trimesh | None:
    """Return a mesh of fewer faces within ``tolerance`` [m] of a watertight one, or None if there is none.

    Smaller tolerances are tried, too, since a wall vanishes that is thinner than three of them.
    The result is watertight, has as many closed surfaces, and encloses the same volume within 2 %. Its metadata holds
    the measured ``deviation`` [m], the Hausdorff distance over all vertices and 4000 points of each surface.

    Raises:
        ValueError: The process that simplifies ends without a result.

    Note:
        A mesh of two million faces takes half a minute to load, and 2.6 GB of memory.
    """
    scale = float(mesh.scale)  # single precision suffices in units of the part
    origin = mesh.bounds.mean(axis=0)
    solid = (np.asarray(mesh.vertices - origin, np.float64) / scale, np.asarray(mesh.faces, np.int64))
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


def _collapsed(solid: Mesh, tolerance: float, scale: float, origin: Floats) -> trimesh.Trimesh | None:
    """Return a solid's mesh [m] with short edges collapsed; None if the result is no closed surface.

    Args:
        solid: Vertices and faces in units of ``scale``.
        tolerance: Largest deviation [m].
        scale: Length of one unit [m].
        origin: (3,) origin of the solid [m].
    """
    found = collapse(solid, tolerance / scale)
    if found is None:
        return None
    coarse = trimesh.Trimesh(found[0] * scale, found[1], process=False)
    coarse.apply_translation(origin)
    return coarse if len(coarse.faces) and coarse.is_watertight else None
