"""The scene as the gripper must fear it: the highest measured point of every cell of the bin."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from perception.frame import Frame, Workspace
from perception.geometry import Floats, invert_transform, require_shape
from policies.grasping._kernels import raise_cells, raise_cells_from_depth

_EMPTY = -np.inf
_BOX = np.ones((3, 3), dtype=np.uint8)
_WIDE_BOX = np.ones((5, 5), dtype=np.uint8)


@dataclass(frozen=True, eq=False, kw_only=True)
class HeightMap:
    """Heights above the bin's floor, bin frame; cell (i, j) spans ``origin + cell * [i, i + 1] x [j, j + 1]``.

    Attributes:
        T_bin_world: (4, 4).
        origin: (2,) corner of cell (0, 0) [m]; the map reaches over the walls to their outer faces.
        cell: Edge of a cell [m].
        measured: (X, Y) highest measurement [m], -inf where there is none.
        heights: (X, Y) what the gripper must stay above [m]: walls at least as high as the rim, holes closed with the
            highest of their surroundings.
        inner: Slices of the cells that lie within the walls.
        rim: Height of the walls [m].
        outside: Height assumed beyond the map [m]: the table's.
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
        """Lay a frame's valid pixels into cells of ``cell`` [m].

        Args:
            frame: What was seen.
            workspace: Where the bin stands; its walls are known, not seen.
            cell: [m].
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
        # What is seen in the cells along a wall is the wall's face: they count as holes, as high as the next cells in.
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
        return empty._closed(measured)

    def rasterise(self, points_a: Floats, T_world_a: Floats | None = None) -> Floats:
        """Return (X, Y) the highest of a surface's dense (N, 3) points per cell [m], -inf beside it, no pinholes."""
        require_shape("points_a", points_a, (None, 3))
        raster = np.full(self.measured.shape, _EMPTY)
        T = self.T_bin_world if T_world_a is None else self.T_bin_world @ T_world_a
        raise_cells(raster, self.origin, self.cell, np.ascontiguousarray(points_a), T)
        covered = cv2.morphologyEx(np.isfinite(raster).astype(np.uint8), cv2.MORPH_CLOSE, _BOX).astype(bool)
        pinholes = covered & ~np.isfinite(raster)
        raster[pinholes] = cv2.dilate(raster, _BOX)[pinholes]
        return raster

    def without(self, target: Floats, others: Floats | None = None, *, tolerance: float = 0.004) -> "HeightMap":
        """Take one part out of the map.

        Args:
            target: (X, Y) raster of the part that will be gripped, by :meth:`rasterise`.
            others: (X, Y) highest raster of all other known parts; what of them lies under the target stays. None: the
                floor is assumed under the target.
            tolerance: A measurement this near to the target's surface is the target's [m].

        Returns:
            The map of everything else. Holes are closed anew, so that the target's height does not leak into them.
        """
        require_shape("target", target, self.measured.shape)
        if not np.any(np.isfinite(self.measured[self.inner])):
            return self  # nothing is known: not even beside the target may be entered
        known = np.isfinite(target)
        # One cell around, because the edge's last pixels fall beside the mesh; on a flank the height varies in a cell.
        upper = cv2.dilate(target, _BOX)
        lower = -cv2.dilate(np.where(known, -target, _EMPTY), _BOX)
        seen = np.isfinite(self.measured)
        its_own = seen & (self.measured <= upper + tolerance) & (self.measured >= lower - tolerance)
        removed = its_own | (known & ~seen)
        ground = np.zeros_like(self.measured)
        if others is not None:
            require_shape("others", others, self.measured.shape)
            ground = np.maximum(ground, np.where(seen, np.minimum(others, self.measured), others))
        return self._closed(np.where(removed, ground, self.measured))

    def highest_at(self, points_bin: Floats) -> Floats:
        """Return (N,) heights [m] under (N, 3) points, bin frame."""
        cells = np.floor((points_bin[:, :2] - self.origin) / self.cell).astype(int)
        inside = np.all((cells >= 0) & (cells < self.heights.shape), axis=1)
        i, j = np.where(inside[:, None], cells, 0).T
        return np.where(inside, self.heights[i, j], self.outside)

    def _closed(self, measured: Floats) -> "HeightMap":
        """Return this map with other measurements: holes closed, floor and walls at least as high as they are known."""
        within = np.maximum(measured[self.inner], np.where(np.isfinite(measured[self.inner]), 0.0, _EMPTY))
        if not np.any(np.isfinite(within)):
            within = np.full(within.shape, self.rim)  # nothing is known: nothing may be entered
        while np.any(holes := np.isneginf(within)):
            # Walls stay out of it: holes in their shadow are floor or parts.
            within[holes] = cv2.dilate(within, _WIDE_BOX, borderType=cv2.BORDER_CONSTANT, borderValue=_EMPTY)[holes]
        heights = np.maximum(measured, self.rim)
        heights[self.inner] = within
        return replace(self, measured=measured, heights=heights)


def _stride(frame: Frame, cell: float) -> int:
    """Return the step between pixels that still puts two in every cell, each way."""
    valid = frame.depth[::8, ::8]
    valid = valid[valid > 0]
    footprint = float(np.median(valid)) / float(frame.K[0, 0]) if len(valid) else cell
    return max(int(cell / (2 * footprint)), 1)
