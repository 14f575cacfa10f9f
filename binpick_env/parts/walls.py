"""The thickness of a part's walls: a bent sheet is thin although its bounding box is not."""

import numpy as np
import trimesh

from perception.geometry import Floats

_INSIDE = 1e-6  # depth below the surface from which the opposite one is looked for [m]
_FACING = -0.9  # largest cosine of the normals of two faces of one wall: near a sharp edge they are no wall


def wall_thickness(mesh: trimesh.Trimesh, *, samples: int = 1000) -> Floats:
    """Return the distances [m] from points of the surface, inwards, to a surface that faces the other way.

    Args:
        mesh: Closed mesh with outward normals [m].
        samples: Number of points, spread over the surface; seeded.

    Returns:
        (samples,) distances [m]; infinite where no surface faces the other way.
    """
    centred = trimesh.Trimesh(mesh.vertices - mesh.bounds.mean(axis=0), mesh.faces, process=False)
    points, faces = trimesh.sample.sample_surface(centred, samples, seed=0)
    inwards = -np.asarray(centred.face_normals)[faces]
    starts = points + _INSIDE * inwards
    hit = np.asarray(centred.ray.intersects_first(starts, inwards))
    there = hit >= 0
    normals, on_face = np.asarray(centred.face_normals)[hit], np.asarray(centred.triangles)[hit, 0]
    cosines = np.einsum("ni,ni->n", normals, -inwards)
    with np.errstate(divide="ignore", invalid="ignore"):
        distances = np.einsum("ni,ni->n", on_face - points, normals) / np.einsum("ni,ni->n", inwards, normals)
    thickness: Floats = np.where(there & (cosines <= _FACING), distances, np.inf)
    return thickness
