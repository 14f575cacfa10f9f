"""Whether arm and load stand before the bin as the camera sees it, told from the arm's posture without a frame."""

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from binpick_env.camera.sensor import sensor_model
from binpick_env.env import BinPickEnv
from perception.geometry import NEAR, Floats, invert_transform, project_points, transform_points

_BESIDE = (
    0.03  # width around the bin's inner walls that must be in sight, too [m]: walls, and errors of the camera's pose
)
_ABOVE = 0.06  # height above the rim up to which parts are heaped [m]
_AROUND = 64  # number of points on a ball


class BinView:
    """The bin as camera and projector see it, and the shapes of the arm that may stand before it.

    A load is taken for a ball around the tool centre point, with the part's largest diameter as its radius.
    """

    def __init__(self, env: BinPickEnv) -> None:
        """Look up the arm's shapes, which a real cell has from the arm's maker.

        Args:
            env: The unwrapped cell.
        """
        self._env = env
        model = env.simulation.model
        self._geoms = np.flatnonzero(env.simulation.is_robot_geom & (model.geom_contype != 0)).tolist()
        self._corners = [_corners(model, geom) for geom in self._geoms]
        self._ball = env.part.model.d_max * _ball(_AROUND)
        self._eyes = (0.0, float(getattr(sensor_model(env.sensor), "baseline", 0.0)))

    def clear(self) -> bool:
        """Return whether nothing of arm and load is between the bin and camera, projector or second camera."""
        simulation, frame = self._env.simulation, self._env.frame
        simulation.refresh()
        data, tcp = simulation.data, simulation.T_world_tcp[:3, 3]
        shapes = [
            corners @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            for geom, corners in zip(self._geoms, self._corners, strict=True)
        ]
        bin_world = self._bin_corners()
        for x in dict.fromkeys(self._eyes):
            T_eye_world = invert_transform(frame.T_world_cam)
            T_eye_world[0, 3] -= x
            outline = _outline(frame.K, T_eye_world, bin_world)
            if any(_overlap(outline, _outline(frame.K, T_eye_world, shape)) for shape in [*shapes, tcp + self._ball]):
                return False
        return True

    def _bin_corners(self) -> Floats:
        """Return the (8, 3) world corners of the room that a frame must show [m]."""
        workspace = self._env.workspace
        half, top = workspace.inner_size[:2] / 2 + _BESIDE, workspace.inner_size[2] + _ABOVE
        corners = [[x, y, z] for x in (-half[0], half[0]) for y in (-half[1], half[1]) for z in (0.0, top)]
        return transform_points(workspace.T_world_bin, np.array(corners))


def _corners(model: mujoco.MjModel, geom: int) -> Floats:
    """Return the (N, 3) corners of a convex shape that contains a geom, in its frame [m]."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        vertices: Floats = np.array(model.mesh_vert[first : first + model.mesh_vertnum[mesh]], dtype=np.float64)
        outer: Floats = vertices[ConvexHull(vertices).vertices]
        return outer
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners: Floats = model.geom_aabb[geom, :3] + signs * model.geom_aabb[geom, 3:]
    return corners


def _ball(count: int) -> Floats:
    """Return (count, 3) unit vectors, evenly spread on a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    flat = np.sqrt(1 - z**2)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])


def _outline(K: Floats, T_eye_world: Floats, points_world: Floats) -> NDArray[np.float32] | None:
    """Return the convex outline of points in an image [px]; None if all of them are behind the eye."""
    points_eye = transform_points(T_eye_world, points_world)
    points_eye = points_eye[points_eye[:, 2] > NEAR]
    if len(points_eye) < 3:
        return None
    pixels = project_points(K, points_eye).clip(-1e5, 1e5).astype(np.float32)
    outline: NDArray[np.float32] = np.asarray(cv2.convexHull(pixels), np.float32)
    return outline


def _overlap(first: NDArray[np.float32] | None, second: NDArray[np.float32] | None) -> bool:
    return first is not None and second is not None and cv2.intersectConvexConvex(first, second)[0] > 0
