"""Cameras over a scene, with every backend that this machine has."""

from dataclasses import replace

import numpy as np

from binpick_env.camera import egl
from binpick_env.camera.depth_camera import Capture, DepthCamera
from binpick_env.config import BinConfig, CameraConfig
from perception.geometry import (
    Floats,
    make_transform,
    rotation_about,
)
from tests.binpick_env.camera.camera_scene import CAMERA, Scene

BACKENDS = ["rays", "raster", "egl"]
WORKSPACE = BinConfig().workspace()


def egl_works() -> bool:
    try:
        egl._gl_context(16, 16).free()
    except RuntimeError:
        return False
    return True


def tilted(distance: float = 0.85) -> Floats:
    """Return a camera pose that looks at the bin askew, rolled, and a little beside its centre."""
    turn = rotation_about((1, 0, 0), 0.3) @ rotation_about((0, 1, 0), -0.2) @ rotation_about((0, 0, 1), 0.7)
    R_bin_cam = turn @ np.diag([1.0, -1.0, -1.0])
    return WORKSPACE.T_world_bin @ make_transform(R_bin_cam, (0.01, -0.02, 0.05) - distance * R_bin_cam[:, 2])


def make_camera(
    scene: Scene, config: CameraConfig = CAMERA, pose: Floats | None = None, threads: int | None = 1
) -> DepthCamera:
    return DepthCamera(scene.model, config, scene.workspace, scene.instance_of_geom, pose, threads=threads)


def look(scene: Scene, backend: str = "rays", pose: Floats | None = None, **more: object) -> Capture:
    camera = make_camera(scene, replace(CAMERA, backend=backend), pose)
    capture = camera.capture(scene.data, np.random.default_rng(0), **{"sensor": "none", **more})
    camera.close()
    return capture
