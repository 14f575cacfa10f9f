"""Several bodies in one file: those that overlap or touch are united, others are refused."""

import logging
from collections.abc import Sequence
from pathlib import Path

import manifold3d
import numpy as np
import trimesh

from binpick_env.parts.simplification import from_manifold, to_manifold
from perception.winding import outward, shells_of, signed_volume

log = logging.getLogger(__name__)
_GAP = 1e-5  # share of the extent by which bodies are enlarged that miss each other by rounding


def united(meshes: Sequence[trimesh.Trimesh], path: Path) -> trimesh.Trimesh:
    """Return one body: the mesh itself if there is one, or else the union of overlapping and touching bodies.

    Args:
        meshes: Closed meshes; each may have several closed surfaces, those with normals inwards being cavities.
        path: File that the meshes were read from, which errors name.

    Raises:
        ValueError: Bodies remain apart, or a surface crosses itself.
    """
    bodies = [body for mesh in meshes for body in bodies_of(outward(mesh))]
    if len(bodies) == 1:
        return bodies[0]
    vertices = np.concatenate([body.vertices for body in bodies])
    scale, origin = float(np.ptp(vertices, axis=0).max()), vertices.mean(axis=0)
    for gap in (0.0, _GAP):
        solids = [to_manifold(_enlarged(body, gap * scale) - origin, body.faces, scale) for body in bodies]
        whole = manifold3d.Manifold.batch_boolean(
            [solid for solid in solids if solid is not None], manifold3d.OpType.Add
        )
        if None in solids:
            raise ValueError(f"{path} holds {len(bodies)} bodies, and a surface of one is no closed solid")
        found = from_manifold(whole, scale)
        apart = sum(signed_volume(surface) > 0 for surface in _surfaces(found))
        if apart == 1:
            break
    else:
        raise ValueError(
            f"{path} holds {len(bodies)} bodies, of which {apart} remain apart, but a part is one rigid body: "
            "save one body per file"
        )
    found.apply_translation(origin)
    total = sum(signed_volume(body) for body in bodies)
    log.info(
        "%s holds %d bodies that overlap or touch: they were united, which leaves %.1f %% of the sum of their volumes",
        path,
        len(bodies),
        100 * signed_volume(found) / total,
    )
    return found


def bodies_of(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """Return the bodies of a closed mesh with normals outwards, each with its cavities; the mesh itself if one."""
    surfaces = _surfaces(mesh)
    volumes = [signed_volume(surface) for surface in surfaces]
    outer = [k for k, volume in enumerate(volumes) if volume > 0]
    if len(outer) == 1:
        return [mesh]
    members = {k: [surfaces[k]] for k in outer}
    for k, volume in enumerate(volumes):
        if volume <= 0:
            point = surfaces[k].triangles_center[:1]
            around = [j for j in outer if volumes[j] > -volume and surfaces[j].contains(point)[0]]
            if around:
                members[min(around, key=lambda j: volumes[j])].append(surfaces[k])
    return [joined(group) for group in members.values()]


def joined(meshes: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Return one mesh of all faces, each mesh with its own vertices."""
    counts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [np.asarray(mesh.faces) + start for mesh, start in zip(meshes, counts[:-1], strict=True)]
    vertices = np.concatenate([np.asarray(mesh.vertices, np.float64) for mesh in meshes])
    whole = trimesh.Trimesh(vertices, np.concatenate(faces), process=False)
    whole.remove_unreferenced_vertices()
    return whole


def _surfaces(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """Return each closed surface of a mesh as a mesh of its own."""
    faces = np.asarray(mesh.faces)
    return [trimesh.Trimesh(mesh.vertices, faces[shell], process=False) for shell in shells_of(mesh)]


def _enlarged(body: trimesh.Trimesh, distance: float) -> np.ndarray:
    """Return the vertices of a body, moved outwards by ``distance`` along their normals."""
    vertices = np.asarray(body.vertices, np.float64)
    return vertices + distance * np.asarray(body.vertex_normals) if distance else vertices
