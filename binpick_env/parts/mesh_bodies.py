"""Several bodies in one file: those that overlap or touch are united, others are refused."""

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

from binpick_env.parts.solids import unite
from perception.winding import outward, shells_of, signed_volume

log = logging.getLogger(__name__)
# Shares of the extent by which bodies are enlarged, one after the other. Rounding leaves slits between flush bodies, of
# ten times less than the second; the third is for bodies that miss each other by the tolerance of a CAD program.
_GAPS = (0.0, 1e-6, 1e-5)
_CRACKED = 1e-4  # share of the area that the walls of slits make at least
_MITRE = 10.0  # largest move of an acute corner, in distances between the faces


def united(meshes: Sequence[trimesh.Trimesh], path: Path) -> trimesh.Trimesh:
    """Return one body: the mesh itself if there is one, or else the union of overlapping and touching bodies.

    Args:
        meshes: Closed meshes; each may have several closed surfaces, those with normals inwards being cavities.
        path: File that the meshes were read from, which errors name.

    Raises:
        ValueError: Bodies remain apart, touch only along an edge or in a point, or a surface crosses itself; or the
            process that unites them ends without a result.
    """
    bodies = [body for mesh in meshes for body in bodies_of(outward(mesh))]
    if len(bodies) == 1:
        return bodies[0]
    vertices = np.concatenate([body.vertices for body in bodies])
    scale, origin = float(np.ptp(vertices, axis=0).max()), vertices.mean(axis=0)
    found, apart, thin = None, len(bodies), False
    for gap in _GAPS:
        enlarged = [_enlarged(body, gap * scale) for body in bodies]
        solids = [
            ((np.asarray(body.vertices, np.float64) - origin) / scale, np.asarray(body.faces, np.int64))
            for body in enlarged
        ]
        joint = unite(solids, gap=gap, tolerance=4 * gap)
        if joint is None and found is None:
            raise ValueError(
                f"{path} holds {len(bodies)} bodies, and a surface of one is no closed solid: repair it, for instance "
                "in MeshLab, or save one body per file"
            )
        if joint is None:
            continue
        union = trimesh.Trimesh(joint.mesh[0] * scale, joint.mesh[1], process=False)
        left = sum(signed_volume(surface) > 0 for surface in _surfaces(union))
        if found is None or left < apart or (left == apart and union.area < (1 - _CRACKED) * found.area):
            found, apart = union, left
        if apart == 1 and gap > 0:
            apart = joint.groups
            thin = apart > 1
            break
    if thin:
        raise ValueError(
            f"{path} holds {len(bodies)} bodies, of which {apart} remain apart: they touch only along an edge or in a "
            "point, which holds nothing together, but a part is one rigid body: save one body per file, or let them "
            "overlap"
        )
    if found is None or apart > 1:
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
    if len(outer) <= 1:
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


def _enlarged(body: trimesh.Trimesh, distance: float) -> trimesh.Trimesh:
    """Return a body whose faces are moved outwards by ``distance``; itself for 0.

    Faces of two bodies in one plane move to one plane. Vertices move by up to `_MITRE` times as far.
    """
    if distance == 0:
        return body
    normals = np.repeat(np.asarray(body.face_normals), 3, axis=0)
    corners = np.asarray(body.faces).ravel()
    squares, sums = np.zeros((len(body.vertices), 3, 3)), np.zeros((len(body.vertices), 3))
    np.add.at(squares, corners, normals[:, :, None] * normals[:, None, :])
    np.add.at(sums, corners, normals)
    moves = np.einsum("vij,vj->vi", np.linalg.pinv(squares, rcond=1e-3, hermitian=True), sums)
    moves *= (_MITRE / np.maximum(np.linalg.norm(moves, axis=1), _MITRE))[:, None]
    return trimesh.Trimesh(np.asarray(body.vertices) + distance * moves, body.faces, process=False)
