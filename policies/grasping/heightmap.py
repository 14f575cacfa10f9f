"""Height map of the bin: the surface that the gripper must stay above."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from perception.frame import Frame, Workspace
from perception.geometry import Floats, invert_transform, require_shape
from policies.grasping._kernels import raise_cells, raise_cells_from_depth

_EMPTY = -np.inf  # height of a cell without a measurement
_BOX = np.ones((3, 3), dtype=np.uint8)
_WIDE_BOX = np.ones((5, 5), dtype=np.uint8)


@dataclass(frozen=True, eq=False, kw_only=True)
class HeightMap:
    """Heights above the bin's floor, bin frame; cell (i, j) spans ``origin + cell * [i, i + 1] x [j, j + 1]``.

    Attributes:
        T_bin_world: (4, 4) transform from the world to the bin frame.
        origin: (2,) corner of cell (0, 0) [m]; the map extends over the walls to their outer faces.
        cell: Edge length of a cell [m].
        measured: (X, Y) highest measurement [m], -inf where there is none.
        heights: (X, Y) surface that the gripper must stay above [m]: walls are at least as high as the rim, and holes
            are filled with the highest of their surroundings.
        inner: Slices of the cells that lie within the walls.
        rim: Height of the walls [m].
        outside: Height of the table, which is assumed beyond the map [m].
    """

    T_bin_world: Floats
    origin: Floats
    cell: float
    measured: Floats
    heights: Floats
    inner: tuple[slice, slice]
    rim: float
    outside: float

    @classmethod
    def from_frame(cls, frame: Frame, workspace: Workspace, *, cell: float = 0.002, wall: float = 0.02) -> "HeightMap":
        """Rasterise a frame's valid pixels.

        Args:
            frame: Depth image with its camera.
            workspace: Pose and inner size of the bin, whose walls are known rather than measured.
            cell: Edge length of a cell [m].
            wall: Thickness of walls and floor [m]; the table lies this much below the bin's floor.
        """
        if not (cell > 0 and wall > 0):
            raise ValueError(f"cell and wall must be positive, got {cell} and {wall}")
        ring = int(np.ceil(wall / cell - 1e-9))
        inside = np.maximum((workspace.inner_size[:2] / cell + 1e-9).astype(int), 1)  # a cell cut by a wall is wall
        origin = -workspace.inner_size[:2] / 2 - ring * cell
        measured = np.full(tuple(inside + 2 * ring + (inside * cell < workspace.inner_size[:2] - 1e-9)), _EMPTY)
        T_bin_world = invert_transform(workspace.T_world_bin)
        stride = _stride(frame, cell)
        T_bin_cam = T_bin_world @ frame.T_world_cam
        raise_cells_from_depth(measured, origin, cell, frame.depth, frame.K, T_bin_cam, stride)
        inner = slice(ring, ring + int(inside[0])), slice(ring, ring + int(inside[1]))
        # Measurements in the cells along a wall are of its face. They become holes, as high as the next cells inwards.
        edge = np.zeros(measured.shape, dtype=np.bool_)
        edge[inner] = True
        edge[inner[0].start + 1 : inner[0].stop - 1, inner[1].start + 1 : inner[1].stop - 1] = False
        measured[edge] = _EMPTY
        empty = cls(
            T_bin_world=T_bin_world,
            origin=origin,
            cell=cell,
            measured=measured,
            heights=measured,
            inner=inner,
            rim=float(workspace.inner_size[2]),
            outside=-wall,
        )
        return empty._filled(measured)

    @classmethod
    def plane(cls, cell: float = 0.002) -> "HeightMap":
        """Return an endless plane at height 0, whose frame is the world's.

        Args:
            cell: Edge length of a cell [m].
        """
        floor = np.zeros((1, 1))
        inner = slice(0, 1), slice(0, 1)
        return cls(
            T_bin_world=np.eye(4),
            origin=np.zeros(2),
            cell=cell,
            measured=floor,
            heights=floor,
            inner=inner,
            rim=0.0,
            outside=0.0,
        )

    def rasterise(self, points_a: Floats, T_world_a: Floats | None = None) -> Floats:
        """Return the (X, Y) height of a surface, -inf beside it, pinholes filled.

        Args:
            points_a: (N, 3) dense points on the surface, in any frame [m].
            T_world_a: (4, 4) pose of that frame; the world's own if None.
        """
        require_shape("points_a", points_a, (None, 3))
        raster = np.full(self.measured.shape, _EMPTY)
        T = self.T_bin_world if T_world_a is None else self.T_bin_world @ T_world_a
        raise_cells(raster, self.origin, self.cell, np.ascontiguousarray(points_a), T)
        covered = cv2.morphologyEx(np.isfinite(raster).astype(np.uint8), cv2.MORPH_CLOSE, _BOX).astype(bool)
        pinholes = covered & ~np.isfinite(raster)
        raster[pinholes] = cv2.dilate(raster, _BOX)[pinholes]
        return raster

    def without(self, target: Floats, others: Floats | None = None, *, tolerance: float = 0.004) -> "HeightMap":
        """Remove one part from the map.

        Args:
            target: (X, Y) height of the part that will be gripped, by :meth:`rasterise` [m].
            others: (X, Y) greatest height of all other known parts [m], which stay, under the target as well. The floor
                is assumed under the target if None.
            tolerance: Distance from the target's surface within which a measurement belongs to the target [m].

        Returns:
            The map of everything else. Holes are filled anew, so that the target's height does not leak into them.
        """
        require_shape("target", target, self.measured.shape)
        if not np.any(np.isfinite(self.measured[self.inner])):
            return self  # nothing was measured: the gripper may not enter, not even beside the target
        known = np.isfinite(target)
        # One cell around: the last pixels of an edge fall beside the mesh, and a flank's height varies within a cell.
        upper = cv2.dilate(target, _BOX)
        lower = -cv2.dilate(np.where(known, -target, _EMPTY), _BOX)
        measured = np.isfinite(self.measured)
        its_own = measured & (self.measured <= upper + tolerance) & (self.measured >= lower - tolerance)
        removed = its_own | (known & ~measured)
        ground = np.zeros_like(self.measured)
        if others is not None:
            require_shape("others", others, self.measured.shape)
            ground = np.maximum(ground, np.where(measured, np.minimum(others, self.measured), others))
        return self._filled(np.where(removed, ground, self.measured))

    def highest_at(self, points_bin: Floats) -> Floats:
        """Return the (N,) heights to stay above [m] under (N, 3) points, bin frame."""
        cells = np.floor((points_bin[:, :2] - self.origin) / self.cell).astype(int)
        inside = np.all((cells >= 0) & (cells < self.heights.shape), axis=1)
        i, j = np.where(inside[:, None], cells, 0).T
        return np.where(inside, self.heights[i, j], self.outside)

    def _filled(self, measured: Floats) -> "HeightMap":
        """Return the map of other measurements: holes filled, floor and walls at least at their known heights."""
        within = np.maximum(measured[self.inner], np.where(np.isfinite(measured[self.inner]), 0.0, _EMPTY))
        if not np.any(np.isfinite(within)):
            within = np.full(within.shape, self.rim)  # nothing was measured: the gripper may not enter
        while np.any(holes := np.isneginf(within)):
            # Walls do not grow into holes: what lies in their shadow is floor or parts.
            within[holes] = cv2.dilate(within, _WIDE_BOX, borderType=cv2.BORDER_CONSTANT, borderValue=_EMPTY)[holes]
        heights = np.maximum(measured, self.rim)
        heights[self.inner] = within
        return replace(self, measured=measured, heights=heights)


def _stride(frame: Frame, cell: float) -> int:
    """Return the largest step between pixels that still puts two in every cell along each axis."""
    valid = frame.depth[::8, ::8]
    valid = valid[valid > 0]
    footprint = float(np.median(valid)) / float(frame.K[0, 0]) if len(valid) else cell
    return max(int(cell / (2 * footprint)), 1)
