"""Number of boundary points of an unoccluded part (P of the paper), by rendering it alone from many directions."""

from dataclasses import asdict
from functools import lru_cache

import numpy as np

from binpick_env.camera.depth_camera import DepthCamera
from binpick_env.cell.simulation import Simulation
from binpick_env.config import CameraConfig, CellConfig
from binpick_env.parts.part import Part, load_part
from binpick_env.parts.unit import Unit
from perception.boundary import extract_boundary
from perception.geometry import Floats, make_transform
from perception.pose.model._pair_kernels import tangent_frames
from perception.pose.model.viewpoints import ViewCount, view_directions
from perception.runtime.cache import cached_arrays, digest

_VERSION = 1  # version of the cached counts; raise it when the same part and camera give other numbers
_VIEWS: ViewCount = 26
_HEIGHT = 0.07  # height of the part's centre over the bin's floor, unless the part is larger [m]


@lru_cache(maxsize=8)
def whole_part_points(part: str, unit: Unit | None, camera: CameraConfig) -> float:
    """Return P times the part's depth [m]; divided by another depth it is P at that depth.

    P is the largest number of boundary pixels over 26 views, by a camera straight above the bin, with default light and
    a sensor without noise. The counts are cached on disk; the first call takes some seconds.

    Args:
        part: Catalogue name, or path of a mesh file.
        unit: Length unit of a mesh file; the most plausible one by default.
        camera: Image size, focal length and distance of the camera.
    """
    loaded = load_part(part, unit=unit)
    mesh = loaded.model.mesh
    key = digest(_VERSION, np.asarray(mesh.vertices), np.asarray(mesh.faces), asdict(camera))
    arrays = cached_arrays("whole-part", key, lambda: {"points": _count(loaded, camera)})
    return float(arrays["points"].max()) * (camera.distance - _height(loaded))


def _count(part: Part, camera_config: CameraConfig) -> Floats:
    """Return the (V,) number of boundary pixels of the part from each of V directions."""
    simulation = Simulation(CellConfig(camera=camera_config), part, 1)
    workspace = simulation.config.bin.workspace()
    camera = DepthCamera(simulation.model, camera_config, workspace, simulation.part_of_geom, threads=1)
    counts = []
    for turn in tangent_frames(view_directions(_VIEWS)):
        # The first row of the frame, the direction towards the viewer, becomes the camera's -z.
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
    """Return the height of the part's centre over the bin's floor [m], such that the part is clear of it."""
    reach = np.linalg.norm(np.asarray(part.model.mesh.vertices) - part.model.centre, axis=1).max()
    return max(_HEIGHT, float(reach) + 0.005)
