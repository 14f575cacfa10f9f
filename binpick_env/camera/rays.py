"""The reference backend: MuJoCo's own ray casting, bit-identical on any number of threads and without GL."""

import copy
from collections import deque
from concurrent.futures import ThreadPoolExecutor

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from binpick_env.camera import _ray_kernels as _kernels
from binpick_env.camera.view import VISIBLE, Hits, View, visible_geoms
from perception.geometry import NEAR, Floats, project_points

CHUNK = 16384  # number of rays in one call of MuJoCo; small enough that two threads finish together
MARGIN = 2  # width by which an outline is grown [px], more than its rounding to integers can lose


class RayCaster:
    """Casts one ray through every pixel of a view, only at the geoms whose outline holds the pixel.

    The pixels are sorted by the set of geoms that their ray can meet; each set is one or more calls of ``mj_multiRay``
    on a private model in which the other geoms are hidden. MuJoCo's own culling is left out: it bounds geoms by angles
    about the world's z axis and misses surfaces around that axis, where a camera that points straight down sees them.
    """

    def __init__(self, model: mujoco.MjModel, threads: int) -> None:
        if threads < 1:
            raise ValueError(f"threads must be at least 1, got {threads}")
        self._geoms = visible_geoms(model)
        self._outlines = {int(g): _outline_points(model, g) for g in self._geoms}
        self._workers = [_Worker(model) for _ in range(threads)]

    def cast(self, view: View) -> Hits:
        """Return the first hit behind every pixel of the view's region; normals are those of the flat faces."""
        hits = Hits.empty(view)
        pixels, start, sets = self._group(view)
        chunks = deque(
            (sets[g], pixels[a : min(a + CHUNK, start[g + 1])])
            for g in range(1, len(sets))
            for a in range(start[g], start[g + 1], CHUNK)
        )

        def work(worker: _Worker) -> None:
            worker.take_poses(view)
            while True:
                try:
                    geoms, chunk = chunks.popleft()
                except IndexError:
                    return
                worker.cast(view, geoms, chunk, hits)

        if len(self._workers) == 1:
            work(self._workers[0])
        else:
            with ThreadPoolExecutor(len(self._workers)) as pool:
                list(pool.map(work, self._workers))
        return hits

    def _group(self, view: View) -> tuple[NDArray[np.int64], NDArray[np.int64], list[tuple[int, ...]]]:
        """Sort the region's pixels by the set of geoms that their rays can meet.

        Returns:
            (P,) flat pixel indices, the (G + 1,) index at which each group starts in them, each group's geoms.
        """
        u0, v0, u1, v1 = view.region
        group_at = np.full((view.height, view.width), -1, np.int32)
        group_at[v0:v1, u0:u1] = 0
        sets: list[tuple[int, ...]] = [()]
        for geom, points in self._outlines.items():
            outline = _outline(points @ view.rotations[geom].T + view.positions[geom], view)
            if outline is None:
                continue
            inside, left, top = outline
            child = np.full(len(sets), -1, np.int32)
            _kernels.split_groups(group_at, inside, left, top, child, len(sets))
            olds = np.nonzero(child >= 0)[0]
            sets += [(*sets[old], geom) for old in olds[np.argsort(child[olds])]]
        pixels, start = _kernels.group_pixels(group_at, view.region, len(sets))
        return pixels, start, sets


class _Worker:
    """Model and state of one thread: visible geoms change with each call, and poses are in the camera frame."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = copy.copy(model)
        self._data = mujoco.MjData(self._model)
        self._geomnum = model.body_geomnum.copy()
        self._groups = np.eye(1, mujoco.mjNGROUP, VISIBLE, dtype=np.uint8)[0]
        # A body without a bounding volume is not culled by MuJoCo.
        self._model.body_bvhadr[:] = -1

    def take_poses(self, view: View) -> None:
        self._data.geom_xpos[:] = view.positions
        self._data.geom_xmat[:] = view.rotations.reshape(-1, 9)

    def cast(self, view: View, geoms: tuple[int, ...], pixels: NDArray[np.int64], hits: Hits) -> None:
        bodies = self._model.geom_bodyid[list(geoms)]
        self._model.body_geomnum[:] = 0
        self._model.body_geomnum[bodies] = self._geomnum[bodies]
        self._model.geom_group[:] = VISIBLE + 1
        self._model.geom_group[list(geoms)] = VISIBLE
        count = len(pixels)
        rays = _kernels.pixel_rays(pixels, view.width, view.K)
        geom, depth, normal = np.empty(count, np.int32), np.empty(count), np.empty(3 * count)
        mujoco.mj_multiRay(
            self._model, self._data, np.zeros(3), rays, self._groups, 1, -1, geom, depth, normal, count, mujoco.mjMAXVAL
        )
        _kernels.scatter_hits(
            pixels, geom, depth, normal, hits.depth.reshape(-1), hits.geom_at.reshape(-1), hits.normals.reshape(-1, 3)
        )


def _outline_points(model: mujoco.MjModel, geom: int) -> Floats:
    """Return (N, 3) points in the geom's frame whose convex hull holds it; none (0, 3) for an unbounded plane."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
        return np.zeros((0, 3))
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        return np.array(model.mesh_vert[first : first + model.mesh_vertnum[mesh]], np.float64)
    centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return np.asarray(centre + signs * half)


def _outline(points_cam: Floats, view: View) -> tuple[NDArray[np.uint8], int, int] | None:
    """Fill the convex outline of points in the image: a mask (h, w), its left and its top; None if out of view."""
    u0, v0, u1, v1 = (int(x) for x in view.region)
    everywhere = np.ones((v1 - v0, u1 - u0), np.uint8), u0, v0
    if len(points_cam) == 0:
        return everywhere
    behind = points_cam[:, 2] <= NEAR
    if behind.any():
        return None if behind.all() else everywhere
    pixels = project_points(view.K, points_cam)
    if np.abs(pixels).max() > 1e6:  # close to the eye's plane: pixels too far off for integers
        return everywhere
    left, top = (max(int(low) - MARGIN - 1, first) for low, first in zip(pixels.min(axis=0), (u0, v0), strict=True))
    right, bottom = (min(int(high) + MARGIN + 2, end) for high, end in zip(pixels.max(axis=0), (u1, v1), strict=True))
    if left >= right or top >= bottom:
        return None
    hull = cv2.convexHull(np.rint(pixels).astype(np.int32))
    mask = np.zeros((bottom - top + 2 * MARGIN, right - left + 2 * MARGIN), np.uint8)
    cv2.fillConvexPoly(mask, hull - np.array([left - MARGIN, top - MARGIN], np.int32), 1)
    grown = cv2.dilate(mask, np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8))
    return np.ascontiguousarray(grown[MARGIN:-MARGIN, MARGIN:-MARGIN], np.uint8), left, top
