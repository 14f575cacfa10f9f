"""The default backend draws what the reference, MuJoCo's ray casting, sees: on a pile of every catalogue part."""

from dataclasses import replace

import numpy as np
import pytest

from binpick_env.camera.depth_camera import Capture, DepthCamera
from binpick_env.cell.settle import drop_and_settle
from binpick_env.cell.simulation import Simulation
from binpick_env.config import CameraConfig, CellConfig
from binpick_env.parts import CATALOGUE, load_part

CAMERA = CameraConfig(width=640, height=480)


@pytest.mark.slow
@pytest.mark.parametrize("name", CATALOGUE)
def test_raster_and_rays_take_one_picture(name: str) -> None:
    simulation = Simulation(CellConfig(), load_part(name), 12)
    drop_and_settle(simulation, 12, np.random.default_rng(5))

    def look(backend: str) -> Capture:
        config = replace(CAMERA, backend=backend)
        workspace, geoms = simulation.config.bin.workspace(), simulation.part_of_geom
        camera = DepthCamera(simulation.model, config, workspace, geoms, threads=1)
        return camera.capture(simulation.data, np.random.default_rng(0))

    assert CAMERA.backend == "raster"
    rays, raster = look("rays"), look("raster")
    assert len(np.unique(raster.instance_ids)) > 8
    differ = rays.instance_ids != raster.instance_ids
    assert differ.mean() < 1e-5
    np.testing.assert_allclose(raster.depth_true[~differ], rays.depth_true[~differ], atol=1e-5)
