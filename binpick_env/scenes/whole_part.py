"""How many boundary points a part has that nothing hides: P of the paper, by rendering it alone from all round."""

from dataclasses import asdict
from functools import lru_cache

import numpy as np

from binpick_env.camera.depth_camera import DepthCamera
from binpick_env.cell.simulation import Simulation
from binpick_env.config import CameraConfig, CellConfig
from binpick_env.parts import Part, Unit, load_part
from perception.boundary import extract_boundary
from perception.geometry import Floats, make_transform
from perception.pose.model._pair_kernels import tangent_frames
from perception.pose.model.viewpoints import ViewCount, view_directions
from perception.runtime.cache import cached_arrays, digest

_VERSION = 1  # of what is stored: raise it when the same part and camera give other numbers
_VIEWS: ViewCount = 26
_HEIGHT = 0.07  # of the part's centre over the bin's floor, if that is clear of it [m]


@lru_cache(maxsize=8)
def whole_part_points(part: str, unit: Unit | None, camera: CameraConfig) -> float:
    """Return P times the depth [m] it holds at: the boundary pixels of the part's largest view are this by the depth.

    Of 26 views, with the camera straight above, the sensor without noise and the light as it is by default. Kept in the
    cache folder; the first call takes some seconds.
    """
    loaded = load_part(part, unit=unit)
    mesh = loaded.model.mesh
    key = digest(_VERSION, np.asarray(mesh.vertices), np.asarray(mesh.faces), asdict(camera))
    arrays = cached_arrays("whole-part", key, lambda: {"points": _count(loaded, camera)})
    return float(arrays["points"].max()) * (camera.distance - _height(loaded))


def _count(part: Part, camera_config: CameraConfig) -> Floats:
    """Return (V,) boundary pixels of the part, its centre `_HEIGHT` over the bin's floor, from each view."""
    simulation = Simulation(CellConfig(camera=camera_config), part, 1)
    workspace = simulation.config.bin.workspace()
    camera = DepthCamera(simulation.model, camera_config, workspace, simulation.part_of_geom, threads=1)
    counts = []
    for turn in tangent_frames(view_directions(_VIEWS)):
        # The view's direction becomes the camera's -z: x of the frame turned there.
        R_cam_part = np.stack([turn[1], turn[2], turn[0]]) * np.array([[1.0], [-1.0], [-1.0]])
        shift = np.array([0.0, 0.0, camera_config.distance - _height(part)]) - R_cam_part @ part.model.centre
        simulation.reset()
        simulation.place(0, camera.T_world_cam @ make_transform(R_cam_part, shift))
        simulation.refresh()
        capture = camera.capture(simulation.data, np.random.default_rng(0), "none")
        pixels = extract_boundary(capture.frame, workspace).pixels
        counts.append(np.count_nonzero(capture.instance_ids[pixels[:, 1], pixels[:, 0]] == 0))
    return np.array(counts, dtype=np.float64)


def _height(part: Part) -> float:
    """Return how high over the floor the part's centre is held [m]."""
    reach = np.linalg.norm(np.asarray(part.model.mesh.vertices) - part.model.centre, axis=1).max()
    return max(_HEIGHT, float(reach) + 0.005)
