"""How deep parts are inside the walls and floors of the cell, from their shapes and not from the engine's contacts."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from binpick_env.cell.scene import BIN_BODY, TABLE_GEOM, TRAY_BODY
from binpick_env.cell.simulation import Simulation
from perception.geometry import Floats


class DepthGauge:
    """Measures the depth of the parts' vertices in the boxes of bin, tray and table.

    Attributes:
        names: Names of the boxes.
        middles: (boxes,) depth of the middle of each box [m].
    """

    def __init__(self, simulation: Simulation) -> None:
        """Look up the boxes, which never move, and the corners of the part's convex pieces."""
        self._simulation = simulation
        model = simulation.model
        owners = {model.body(BIN_BODY).id, model.body(TRAY_BODY).id}
        boxes = [
            g
            for g in range(model.ngeom)
            if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_BOX
            and model.geom_contype[g]
            and (model.geom_bodyid[g] in owners or g == model.geom(TABLE_GEOM).id)
        ]
        simulation.refresh()
        self.names = [model.geom(g).name for g in boxes]
        self._half = np.array(model.geom_size[boxes])
        # Where a point is as near to the outside as to the inside.
        self.middles: Floats = self._half.min(axis=1)
        self._centres = np.array(simulation.data.geom_xpos[boxes])
        self._axes = np.array(simulation.data.geom_xmat[boxes]).reshape(-1, 3, 3)
        self._corners = np.concatenate([np.asarray(piece.vertices) for piece in simulation.part.pieces])

    def depths(self) -> tuple[Floats, NDArray[np.int64]]:
        """Return the (capacity,) depths of the parts in play inside the boxes [m], and the number of the box of each.

        The depth of a point is its distance from the nearest face. It is 0 where a part is inside no box or out of
        play.
        """
        simulation = self._simulation
        depths, boxes = np.zeros(simulation.capacity), np.zeros(simulation.capacity, np.int64)
        parts = np.flatnonzero(simulation.in_play)
        if not len(parts):
            return depths, boxes
        poses = simulation.part_poses()[parts]
        corners_world = self._corners @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
        in_boxes = np.stack([self._depths_in(k, corners_world) for k in range(len(self.names))])  # (boxes, parts)
        boxes[parts] = np.argmax(in_boxes, axis=0)
        depths[parts] = np.maximum(in_boxes.max(axis=0), 0.0)
        return depths, boxes

    def _depths_in(self, k: int, points_world: Floats) -> Floats:
        """Return the (P,) largest depths of (P, N, 3) points in box ``k`` [m]; not positive where none is inside."""
        points_box = (points_world - self._centres[k]) @ self._axes[k]
        depths: Floats = (self._half[k] - np.abs(points_box)).min(axis=2).max(axis=1)
        return depths
