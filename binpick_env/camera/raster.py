"""The raster backend: visible meshes and boxes drawn as triangles into a z-buffer, with smooth normals for shading."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from binpick_env.camera import _normal_kernels
from binpick_env.camera import _raster_kernels as _kernels
from binpick_env.camera.view import Hits, View, visible_geoms
from perception.geometry import Floats

CREASE = np.deg2rad(35.0)  # faces that meet at less are one smooth surface; a cylinder of 12 sides and more is round
_BOX_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_BOX_FACES = np.array(
    [0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5, 0, 4, 5, 0, 5, 1, 2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3],
    np.int32,
).reshape(12, 3)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Soup:
    """One geom's triangles in its frame: (V, 3) vertices, (T, 3) faces, (T, 3, 3) corner normals, closed or not."""

    vertices: Floats
    faces: NDArray[np.int32]
    normals: NDArray[np.float32]
    closed: bool


class Rasteriser:
    """Draws every visible mesh and box of a model.

    Geoms of other types (spheres, cylinders, planes) are named in ``left_out``: the ``raster`` backend refuses them.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.left_out: list[str] = []
        soups: list[_Soup] = []
        owners: list[int] = []
        known: dict[int, _Soup] = {}
        for geom in visible_geoms(model):
            kind = mujoco.mjtGeom(model.geom_type[geom])
            if kind == mujoco.mjtGeom.mjGEOM_MESH:
                mesh = int(model.geom_dataid[geom])
                if mesh not in known:
                    known[mesh] = _mesh_soup(model, mesh)
                soup = known[mesh]
            elif kind == mujoco.mjtGeom.mjGEOM_BOX:
                soup = _soup(_BOX_CORNERS * model.geom_size[geom], _BOX_FACES)
            else:
                self.left_out.append(f"{model.geom(geom).name or geom} ({kind.name.removeprefix('mjGEOM_').lower()})")
                continue
            soups.append(soup)
            owners.append(int(geom))
        self._geoms = np.array(owners, np.int64)
        self._gather(soups)

    def _gather(self, soups: list[_Soup]) -> None:
        first = np.cumsum([0, *(len(s.vertices) for s in soups)])
        ends = np.cumsum([0, *(len(s.faces) for s in soups)])
        self._face_range = np.stack([ends[:-1], ends[1:]], axis=1).astype(np.int64)
        self._vertex_range = np.stack([first[:-1], first[1:]], axis=1).astype(np.int64)
        self._vertices = np.concatenate([np.zeros((0, 3)), *(s.vertices for s in soups)])
        self._vertex_geom = np.repeat(self._geoms, np.diff(first))
        self._faces = np.concatenate(
            [np.zeros((0, 3), np.int32), *(s.faces + np.int32(n) for s, n in zip(soups, first, strict=False))]
        ).astype(np.int32)
        self._face_geom = np.repeat(self._geoms, np.diff(ends)).astype(np.int32)
        self._normals = np.concatenate([np.zeros((0, 3, 3), np.float32), *(s.normals for s in soups)])
        self._two_sided = np.repeat(np.array([not s.closed for s in soups], np.bool_), np.diff(ends))

    def draw(self, view: View) -> Hits:
        """Return the nearest mesh or box behind every pixel of the view's region, with smooth normals."""
        vertices, depth, face_at = self._draw(view)
        normals = np.zeros((view.height, view.width, 3), np.float32)
        self._interpolate(view, vertices, face_at, normals)
        _kernels.faces_to_geoms(face_at, self._face_geom, depth)
        return Hits(depth=depth, geom_at=face_at, normals=normals)

    def smooth(self, view: View, hits: Hits) -> Hits:
        """Replace flat normals by smooth ones wherever the rasteriser finds the same geom as ``hits``.

        MuJoCo's rays give the normal of the flat face, which would show the facets of a cylinder as edges.
        """
        vertices, _, face_at = self._draw(view)
        normals = hits.normals.copy()
        if len(self._faces):
            face_at[self._face_geom[face_at] != hits.geom_at] = -1
        self._interpolate(view, vertices, face_at, normals)
        return Hits(depth=hits.depth, geom_at=hits.geom_at, normals=normals)

    def _draw(self, view: View) -> tuple[Floats, Floats, NDArray[np.int32]]:
        vertices = _kernels.place_vertices(self._vertices, self._vertex_geom, view.rotations, view.positions)
        depth = np.full((view.height, view.width), np.inf)
        face_at = np.full((view.height, view.width), -1, np.int32)
        ranges = self._vertex_range, self._face_range
        _kernels.rasterise(
            vertices, self._faces, *ranges, self._two_sided, view.K, *view.slopes(), view.region, depth, face_at
        )
        return vertices, depth, face_at

    def _interpolate(
        self, view: View, vertices: Floats, face_at: NDArray[np.int32], normals: NDArray[np.float32]
    ) -> None:
        _normal_kernels.interpolate_normals(
            vertices,
            self._faces,
            self._normals,
            self._face_geom,
            view.rotations,
            *view.slopes(),
            view.region,
            face_at,
            normals,
        )


def _mesh_soup(model: mujoco.MjModel, mesh: int) -> _Soup:
    vertex, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = np.array(model.mesh_vert[vertex : vertex + model.mesh_vertnum[mesh]], np.float64)
    faces = np.array(model.mesh_face[face : face + model.mesh_facenum[mesh]], np.int32)
    return _soup(vertices, faces)


def _soup(vertices: Floats, faces: NDArray[np.int32]) -> _Soup:
    return _Soup(vertices=vertices, faces=faces, normals=corner_normals(vertices, faces), closed=is_closed(faces))


def is_closed(faces: NDArray[np.int32]) -> bool:
    """Tell whether every directed edge of (T, 3) faces is met by its reverse, once each."""
    start, end = faces.astype(np.int64).reshape(-1), np.roll(faces, -1, axis=1).astype(np.int64).reshape(-1)
    size = np.int64(faces.max(initial=0)) + 1
    forward, backward = np.sort(start * size + end), np.sort(end * size + start)
    return bool(np.array_equal(forward, backward) and np.all(np.diff(forward) > 0))


def corner_normals(vertices: Floats, faces: NDArray[np.int32], crease: float = CREASE) -> NDArray[np.float32]:
    """Return (T, 3, 3) unit normals at each face's corners, averaged over the faces that meet smoothly there.

    Args:
        vertices: (V, 3) [m].
        faces: (T, 3) int32, counter-clockwise from outside.
        crease: Faces at a vertex whose normals differ by less [rad] are averaged, weighted by their angle there.
    """
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    ahead, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = np.sum(ahead * back, axis=2) / np.maximum(
        np.linalg.norm(ahead, axis=2) * np.linalg.norm(back, axis=2), 1e-30
    )
    angle = np.arccos(np.clip(cosine, -1.0, 1.0)).reshape(-1)
    # Corners sorted by vertex: each meets the run of corners at its own vertex, a ring of pairs at a time.
    owner = faces.reshape(-1)
    order = np.argsort(owner, kind="stable")
    begin = np.searchsorted(owner[order], np.arange(len(vertices)))
    count = np.bincount(owner, minlength=len(vertices))
    flat = np.repeat(normals, 3, axis=0)
    total = np.zeros_like(flat)
    for k in range(int(count.max(initial=0))):
        has = np.nonzero(count[owner] > k)[0]
        other = order[begin[owner[has]] + k]
        together = np.sum(flat[has] * flat[other], axis=1) >= np.cos(crease)
        total[has] += (angle[other] * together)[:, None] * flat[other]
    length = np.linalg.norm(total, axis=1, keepdims=True)
    smooth = np.where(length > 1e-12, total / np.maximum(length, 1e-12), flat)
    return smooth.reshape(-1, 3, 3).astype(np.float32)
