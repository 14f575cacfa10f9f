"""Pictures of the cell for people: by OpenGL where it works, by ray casting everywhere else."""

import logging
import os
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from binpick_env.simulation import Simulation
from perception.geometry import Floats, camera_matrix

_log = logging.getLogger(__name__)
_SEEN = np.array([0, 0, 1, 0, 0, 0], dtype=np.uint8)  # geom group 2: what is visible
_SKY = np.array([232.0, 236.0, 240.0])
_LIGHT = np.array([-0.35, -0.45, 0.82])


def look_at(eye: Floats, target: Floats) -> Floats:
    """Return ``T_world_cam`` (4, 4), OpenCV axes, of a camera at ``eye`` (3,) that looks at ``target`` (3,), z up."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    T[:3, 3] = eye
    return T


def default_viewpoint(simulation: Simulation) -> Floats:
    """Return the pose of a camera that sees the bin, the tray and the arm."""
    x, y = simulation.config.bin.position
    return look_at(np.array([x + 0.95, y - 0.75, 0.85]), np.array([x - 0.12, y - 0.14, 0.14]))


def cast_picture(
    simulation: Simulation, T_world_cam: Floats, width: int = 640, height: int = 480, focal_px: float | None = None
) -> NDArray[np.uint8]:
    """Return an (H, W, 3) uint8 RGB picture, shaded by one lamp. No GL is needed.

    Note: about 2 us a pixel on one core.
    """
    model, data = simulation.model, simulation.data
    K = camera_matrix(focal_px or 1.05 * width, width, height)
    v, u = np.mgrid[0:height, 0:width].reshape(2, -1)
    rays_cam = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(len(u))], axis=1)
    rays_world = rays_cam @ T_world_cam[:3, :3].T
    eye = T_world_cam[:3, 3]
    geom, distance, normal = _cast(model, data, eye, rays_world)
    hit = geom >= 0
    colour = np.tile(_SKY, (len(u), 1))
    colour[hit] = 255.0 * _rgb(model)[geom[hit]]
    light = _LIGHT / np.linalg.norm(_LIGHT)
    normal = np.where((np.sum(normal * rays_world, axis=1) > 0)[:, None], -normal, normal)
    diffuse = np.clip(normal @ light, 0.0, 1.0)
    fill = 0.5 + 0.5 * np.clip(normal[:, 2], -1.0, 1.0)
    shade = np.where(hit, 0.30 * fill + 0.25 + 0.55 * diffuse, 1.0)
    return np.clip(colour * shade[:, None], 0, 255).astype(np.uint8).reshape(height, width, 3)


def _rgb(model: mujoco.MjModel) -> Floats:
    """Return (ngeom, 3) colours; a material's colour goes before the geom's own."""
    rgba = model.geom_rgba.astype(np.float64)
    material = model.geom_matid
    rgba[material >= 0] = model.mat_rgba[material[material >= 0]]
    return rgba[:, :3]


def _cast(
    model: mujoco.MjModel, data: mujoco.MjData, eye: Floats, rays: Floats
) -> tuple[NDArray[np.int32], Floats, Floats]:
    count = len(rays)
    geom = np.full(count, -1, dtype=np.int32)
    distance = np.zeros(count)
    normal = np.zeros(3 * count)
    mujoco.mj_multiRay(
        model, data, eye, np.ascontiguousarray(rays).ravel(), _SEEN, True, -1, geom, distance, normal, count, 10.0
    )
    return geom, distance, normal.reshape(-1, 3)


class CellRenderer:
    """What the environment's render modes show; GL is tried once, lazily, and given up with one logged line."""

    def __init__(self, simulation: Simulation, width: int = 640, height: int = 480) -> None:
        self._simulation = simulation
        self._size = (height, width)
        self._gl: mujoco.Renderer | None = None
        self._no_gl = False
        self._viewer: Any = None

    def picture(self) -> NDArray[np.uint8]:
        """Return an (H, W, 3) uint8 RGB picture of the cell."""
        renderer = self._gl_renderer()
        if renderer is None:
            height, width = self._size
            return cast_picture(self._simulation, default_viewpoint(self._simulation), width, height)
        T_world_cam = default_viewpoint(self._simulation)
        camera = mujoco.MjvCamera()
        forward = T_world_cam[:3, 2]
        camera.lookat = T_world_cam[:3, 3] + forward
        camera.distance = 1.0
        camera.azimuth = np.degrees(np.arctan2(forward[1], forward[0]))
        camera.elevation = np.degrees(np.arcsin(forward[2]))
        renderer.update_scene(self._simulation.data, camera)
        return renderer.render()

    def show(self) -> None:
        """Refresh MuJoCo's interactive viewer, opening it at the first call.

        Raises:
            RuntimeError: There is no display or no GL driver.
        """
        if self._viewer is None:
            if os.name == "posix" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
                raise RuntimeError("render_mode='human' needs a display and none is set; use 'rgb_array', which needs none")
            import mujoco.viewer  # noqa: PLC0415 - loads a window system

            self._viewer = mujoco.viewer.launch_passive(self._simulation.model, self._simulation.data)
        self._viewer.sync()

    def close(self) -> None:
        """Close the viewer and the GL context, if there were any."""
        if self._viewer is not None:
            self._viewer.close()
        if self._gl is not None:
            self._gl.close()
        self._viewer = self._gl = None

    def _gl_renderer(self) -> mujoco.Renderer | None:
        """Return a GL renderer, or None where there is none; ``MUJOCO_GL`` must name one: a guess can abort Python."""
        if self._gl is None and not self._no_gl:
            try:
                if not os.environ.get("MUJOCO_GL"):
                    raise RuntimeError("MUJOCO_GL is not set")
                self._gl = mujoco.Renderer(self._simulation.model, *self._size)
            except Exception as error:  # MuJoCo raises many types here, driver by driver
                self._no_gl = True
                _log.info("no OpenGL (%s): pictures are ray cast; set MUJOCO_GL=egl or glfw to use a driver", error)
        return self._gl
