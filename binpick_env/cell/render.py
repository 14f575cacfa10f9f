"""Pictures of the cell for people, by OpenGL where ``MUJOCO_GL`` asks for it and it works, else by the rasteriser."""

import logging
import os
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from binpick_env.camera.raster import Rasteriser
from binpick_env.camera.view import View, geoms_in_camera, visible_geoms
from binpick_env.cell.simulation import Simulation
from perception.geometry import Floats, camera_matrix

_log = logging.getLogger(__name__)
_SKY = np.array([232.0, 236.0, 240.0])
_LIGHT = np.array([-0.35, -0.45, 0.82]) / np.linalg.norm([-0.35, -0.45, 0.82])


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


class PicturePainter:
    """Paints shaded pictures of a simulation with the camera's rasteriser; needs no GL."""

    def __init__(self, simulation: Simulation) -> None:
        """Gather the visible meshes; about 0.3 s."""
        self._simulation = simulation
        self._geoms = visible_geoms(simulation.model)
        self._rasteriser = Rasteriser(simulation.model)
        self._rgb = _colours(simulation.model)

    def paint(
        self, T_world_cam: Floats, width: int = 640, height: int = 480, focal_px: float | None = None
    ) -> NDArray[np.uint8]:
        """Return an (H, W, 3) uint8 RGB picture, lit by one lamp without shadows.

        Args:
            T_world_cam: (4, 4) pose of the camera, OpenCV axes.
            width: Width of the picture [px].
            height: Height of the picture [px].
            focal_px: Focal length [px]; 1.05 times the width by default.
        """
        simulation = self._simulation
        rotations, positions = geoms_in_camera(simulation.model, simulation.data, self._geoms, T_world_cam)
        view = View(
            K=camera_matrix(focal_px or 1.05 * width, width, height),
            width=width,
            height=height,
            region=np.array([0, 0, width, height]),
            rotations=rotations,
            positions=positions,
        )
        hits = self._rasteriser.draw(view)
        normals_world = hits.normals @ T_world_cam[:3, :3].T
        diffuse = np.clip(normals_world @ _LIGHT, 0.0, 1.0)
        fill = 0.5 + 0.5 * normals_world[..., 2]
        shade = 0.30 * fill + 0.25 + 0.55 * diffuse
        lit = 255.0 * self._rgb[hits.geom_at] * shade[..., None]
        picture = np.where((hits.geom_at >= 0)[..., None], lit, _SKY)
        return np.asarray(np.clip(picture, 0, 255), dtype=np.uint8)


def _colours(model: mujoco.MjModel) -> Floats:
    """Return the (ngeom, 3) colours of the geoms, those of their materials where they have one."""
    rgba = model.geom_rgba.astype(np.float64)
    material = model.geom_matid
    rgba[material >= 0] = model.mat_rgba[material[material >= 0]]
    return np.ascontiguousarray(rgba[:, :3])


class CellRenderer:
    """Renders the environment's pictures and its viewer. GL is tried once, at the first picture."""

    def __init__(self, simulation: Simulation, width: int = 640, height: int = 480) -> None:
        """Prepare pictures of ``width`` x ``height`` [px]; nothing is opened yet."""
        self._simulation = simulation
        self._size = (height, width)
        self._gl: mujoco.Renderer | None = None
        self._no_gl = False
        self._painter: PicturePainter | None = None
        self._viewer: Any = None

    def picture(self) -> NDArray[np.uint8]:
        """Return an (H, W, 3) uint8 RGB picture of the cell."""
        renderer = self._gl_renderer()
        if renderer is None:
            height, width = self._size
            self._painter = self._painter or PicturePainter(self._simulation)
            return self._painter.paint(default_viewpoint(self._simulation), width, height)
        T_world_cam = default_viewpoint(self._simulation)
        camera = mujoco.MjvCamera()
        forward = T_world_cam[:3, 2]
        camera.lookat = T_world_cam[:3, 3] + forward
        camera.distance = 1.0
        camera.azimuth = np.degrees(np.arctan2(forward[1], forward[0]))
        camera.elevation = np.degrees(np.arcsin(forward[2]))
        renderer.update_scene(self._simulation.data, camera)
        return np.asarray(renderer.render(), dtype=np.uint8)

    def show(self) -> None:
        """Refresh MuJoCo's interactive viewer, opening it at the first call.

        Raises:
            RuntimeError: There is no display or no GL driver.
        """
        if self._viewer is None:
            if os.name == "posix" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
                raise RuntimeError("render_mode='human' needs a display, and none is set; 'rgb_array' needs none")
            import mujoco.viewer

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
                _log.info(
                    "no OpenGL (%s): pictures are rasterised on the CPU; set MUJOCO_GL=egl or glfw to use a driver",
                    error,
                )
        return self._gl
