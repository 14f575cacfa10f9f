"""Winding of a mesh's faces: normals point out of the material, so those of an inner cavity point into the cavity."""

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

_PROBES = 9  # vertices of a shell that are tested for lying inside another one; the majority decides


def shells_of(mesh: trimesh.Trimesh) -> list[NDArray[np.int64]]:
    """Return the faces of each closed surface of a mesh, as ascending indices, in the order of their first face."""
    first, second = np.asarray(mesh.face_adjacency).T
    count = len(mesh.faces)
    links = coo_matrix((np.ones(len(first), np.bool_), (first, second)), shape=(count, count))
    labels = connected_components(links, directed=False)[1]
    order = np.argsort(labels, kind="stable")
    shells = np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)
    return sorted(shells, key=lambda faces: int(faces[0]))


def signed_volume(mesh: trimesh.Trimesh) -> float:
    """Return the volume of a closed mesh [m^3], negative if its normals point inwards; trimesh's warns of volume 0."""
    a, b, c = np.moveaxis(np.asarray(mesh.triangles, np.float64) - mesh.bounds.mean(axis=0), 1, 0)
    return float(np.einsum("ti,ti->", a, np.cross(b, c))) / 6


def outward(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a watertight mesh whose normals point out of the material.

    A closed surface that lies in no other one is turned outwards. One that lies in another keeps its winding relative
    to it: opposite normals bound a cavity, and equal ones another body. Where its own faces disagree it is taken for a
    cavity.

    Args:
        mesh: Watertight mesh of one or several closed surfaces.

    Returns:
        The same mesh if it is right already, or else a copy.
    """
    shells = shells_of(mesh)
    consistent = bool(mesh.is_winding_consistent)
    if len(shells) == 1:
        if consistent and signed_volume(mesh) >= 0:
            return mesh
        turned = mesh.copy()
        turned.fix_normals()
        if signed_volume(turned) < 0:
            turned.invert()
        return turned
    solids, signs = _outward_shells(mesh, shells)
    inside = _containment(solids)
    faces = np.asarray(mesh.faces).copy()
    for k, (shell, solid) in enumerate(zip(shells, solids, strict=True)):
        containers = np.flatnonzero(inside[k])
        wanted = 1
        if len(containers):
            outermost = max(containers, key=lambda j: signed_volume(solids[j]))
            wanted = -1 if signs[k] == 0 or signs[k] != (signs[outermost] or 1) else 1
        faces[shell] = solid.metadata["faces"] if wanted > 0 else solid.metadata["faces"][:, ::-1]
    if np.array_equal(faces, mesh.faces):
        return mesh
    return trimesh.Trimesh(np.asarray(mesh.vertices), faces, process=False, metadata=dict(mesh.metadata))


def _outward_shells(mesh: trimesh.Trimesh, shells: list[NDArray[np.int64]]) -> tuple[list[trimesh.Trimesh], list[int]]:
    """Return each closed surface turned outwards, and the sign of its volume in the mesh; 0 if its faces disagree."""
    solids, signs = [], []
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    for shell in shells:
        solid = trimesh.Trimesh(vertices, faces[shell], process=False)
        sign = int(np.sign(signed_volume(solid))) if solid.is_winding_consistent else 0
        if sign == 0:
            solid.fix_normals(multibody=False)
        if signed_volume(solid) < 0:
            solid.invert()
        oriented = np.asarray(solid.faces).copy()
        solid.remove_unreferenced_vertices()
        solid.metadata["faces"] = oriented
        solids.append(solid)
        signs.append(sign)
    return solids, signs


def _containment(solids: list[trimesh.Trimesh]) -> NDArray[np.bool_]:
    """Return (S, S) whether solid k lies inside solid j."""
    inside = np.zeros((len(solids), len(solids)), np.bool_)
    for k, inner in enumerate(solids):
        points = inner.triangles_center[np.linspace(0, len(inner.faces) - 1, _PROBES).astype(np.int64)]
        for j, outer in enumerate(solids):
            within = np.all(inner.bounds[0] >= outer.bounds[0]) and np.all(inner.bounds[1] <= outer.bounds[1])
            if j != k and within and signed_volume(outer) > signed_volume(inner):
                inside[k, j] = outer.contains(points).mean() > 0.5
    return inside
