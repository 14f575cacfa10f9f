"""The overhead depth camera: true depth and part ids from one of three backends, then shading and sensor noise."""

import logging
import math
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from binpick_env.camera import _image_kernels
from binpick_env.camera.appearance import Appearance
from binpick_env.camera.depth_sensor import DepthSensor, TrueView
from binpick_env.camera.egl import EglRenderer
from binpick_env.camera.freed_memory import keep_freed_memory
from binpick_env.camera.photograph import photograph
from binpick_env.camera.raster import Rasteriser
from binpick_env.camera.rays import RayCaster
from binpick_env.camera.sensor import SensorModel, sensor_model
from binpick_env.camera.shading import Light
from binpick_env.camera.surface import deviate, label_albedo, part_pixels
from binpick_env.camera.view import Hits, View, geoms_in_camera, visible_geoms
from binpick_env.config import CameraConfig, SensorPreset
from perception.frame import Frame, Workspace, bin_region
from perception.geometry import Floats, camera_matrix, make_transform, require_shape, rotation_about
from perception.runtime.threads import default_threads

log = logging.getLogger(__name__)
MARGIN = 0.03  # width of the rendered border around the bin's inner box [m]: its walls and a little of the table
HEADROOM = 0.03  # height above the rim that is rendered, for a heaped pile [m]
OFF = 0.005  # difference from the true depth up to which a measurement is of the pixel's own surface [m]
REACH = 8  # distance up to which the surface of another depth is looked for [px]; beyond what sensors displace
_TO_EYE = np.array([0.0, 0.0, -1.0], np.float32)


@dataclass(frozen=True, eq=False, kw_only=True)
class Capture:
    """A frame with the ground truth of its pixels.

    Attributes:
        frame: What a real camera would deliver.
        instance_ids: (H, W) int64 part seen by each pixel, -1 for the container and for nothing.
        measured_ids: (H, W) int64 part whose surface has the measured depth, -1 for none. It differs from
            ``instance_ids`` where a sensor puts depths beside their surface, as stereo fattens what is in front.
        depth_true: (H, W) float32 noise-free depth [m], 0 where there is nothing or outside the region.
        normals: (H, W, 3) float32 unit normals, camera frame, towards the eye, smooth across facets; 0 for nothing.
        region: Half-open rectangle ``(u0, v0, u1, v1)`` of the pixels that were rendered.
        T_world_cam: (4, 4) true pose of the camera; the frame has the reported one.
    """

    frame: Frame
    instance_ids: NDArray[np.int64]
    measured_ids: NDArray[np.int64]
    depth_true: NDArray[np.float32]
    normals: NDArray[np.float32]
    region: tuple[int, int, int, int]
    T_world_cam: Floats


class DepthCamera:
    """A structured-light camera over the bin. It sees geoms of group 2, and renders only the bin's image region."""

    def __init__(
        self,
        model: mujoco.MjModel,
        config: CameraConfig,
        workspace: Workspace,
        instance_of_geom: NDArray[np.int64],
        T_world_cam: Floats | None = None,
        *,
        threads: int | None = None,
    ) -> None:
        """Prepare the model's visible geoms; the model's groups, sizes and meshes must not change afterwards.

        Args:
            model: Model with its visible geoms in group 2.
            config: Image size, optics and backend.
            workspace: Pose and inner box of the bin.
            instance_of_geom: (ngeom,) part that each geom belongs to, -1 for none.
            T_world_cam: (4, 4) pose of the camera, OpenCV axes; straight above the bin by default.
            threads: Number of threads that cast rays; unless given, that of ``use_threads`` around it, else one. The
                result does not depend on it.
        """
        instance_of_geom = np.asarray(instance_of_geom, np.int64)
        if instance_of_geom.shape != (model.ngeom,):
            raise ValueError(f"instance_of_geom must be (ngeom,) = ({model.ngeom},), got {instance_of_geom.shape}")
        keep_freed_memory()
        self.config = config
        self.workspace = workspace
        self.K = camera_matrix(config.focal_px, config.width, config.height)
        self._model = model
        self._geoms = visible_geoms(model)
        self._instances = np.append(instance_of_geom, -1)  # at -1: nothing
        self._raster = Rasteriser(model)
        if config.backend == "raster" and self._raster.left_out:
            raise ValueError(
                f"backend 'raster' draws meshes and boxes, but there are {', '.join(self._raster.left_out)}; use 'rays'"
            )
        threads = default_threads() if threads is None else threads
        self._rays = RayCaster(model, threads) if config.backend == "rays" else None
        self._egl = EglRenderer(model, config.width, config.height) if config.backend == "egl" else None
        self.move(default_pose(workspace, config.distance) if T_world_cam is None else T_world_cam)
        if T_world_cam is None:
            _say_what_is_unseen(config, *(float(side) for side in workspace.inner_size))

    def move(self, T_world_cam: Floats) -> None:
        """Put the camera at another (4, 4) pose, OpenCV axes."""
        require_shape("T_world_cam", T_world_cam, (4, 4))
        if not np.isfinite(T_world_cam).all():
            raise ValueError("T_world_cam must be finite")
        self.T_world_cam = np.array(T_world_cam, np.float64)
        self.displace(np.zeros(3))

    def displace(self, offset_world: Floats, rotation_cam: Floats | None = None) -> None:
        """Report another pose than the true one, as after an inexact hand-eye calibration.

        Args:
            offset_world: (3,) offset of the reported position [m].
            rotation_cam: (3,) rotation vector from the true orientation to the reported one, camera frame [rad]; none
                if None.
        """
        require_shape("offset_world", offset_world, (3,))
        rotation_cam = np.zeros(3) if rotation_cam is None else rotation_cam
        require_shape("rotation_cam", rotation_cam, (3,))
        self.offset_world = np.array(offset_world, np.float64)
        self.rotation_cam = np.array(rotation_cam, np.float64)

    def reported_pose(self) -> Floats:
        """Return the (4, 4) pose that frames state."""
        reported: Floats = make_transform(translation=self.offset_world) @ self.T_world_cam
        angle = float(np.linalg.norm(self.rotation_cam))
        if angle > 0:
            reported = reported @ make_transform(rotation_about(self.rotation_cam, angle))
        return reported

    def capture(
        self,
        data: mujoco.MjData,
        rng: np.random.Generator,
        sensor: SensorPreset | DepthSensor = "good",
        light: Light | None = None,
        appearance: Appearance | None = None,
    ) -> Capture:
        """Take a frame of ``data``, whose kinematics must be up to date (``mj_forward`` or a step's).

        Args:
            data: State of the model that the camera was made with; it is not changed.
            rng: Source of the sensor's random numbers.
            sensor: Name of a preset, or a model of the sensor.
            light: Lighting of the grey image; :class:`Light`'s defaults if left out.
            appearance: Departures from the clean image and from the parts' CAD; none if left out. The capture's true
                depth and normals are those of the deviating surfaces.

        Raises:
            ValueError: ``data`` is of another model, or a visible geom's pose is not finite.
        """
        measures = sensor_model(sensor)
        appearance = appearance or Appearance()
        hits, view = self._render(data)
        if appearance.deviation > 0:
            hits = deviate(hits, view, part_pixels(hits.geom_at, self._instances), appearance)
        depth_true = hits.depth.astype(np.float32)
        instance_ids: NDArray[np.int64] = _image_kernels.instances_at(hits.geom_at, self._instances)
        if appearance.is_clean:
            grey = (light or Light()).shade(depth_true, hits.normals, instance_ids, self.K)
        else:
            grey = self._photograph(hits, view, (appearance, light or Light()), rng)
        seen = TrueView(depth=depth_true, normals=hits.normals, grey=grey, K=self.K)
        depth = measures.measure(seen, rng)
        frame = Frame(grey=grey, depth=depth, K=self.K.copy(), T_world_cam=self.reported_pose())
        u0, v0, u1, v1 = (int(x) for x in view.region)
        return Capture(
            frame=frame,
            instance_ids=instance_ids,
            measured_ids=self._measured_ids(depth, depth_true, instance_ids, measures),
            depth_true=depth_true,
            normals=hits.normals,
            region=(u0, v0, u1, v1),
            T_world_cam=self.T_world_cam.copy(),
        )

    def _measured_ids(
        self,
        depth: NDArray[np.float32],
        depth_true: NDArray[np.float32],
        instance_ids: NDArray[np.int64],
        sensor: DepthSensor,
    ) -> NDArray[np.int64]:
        if isinstance(sensor, SensorModel):  # every depth is that of the pixel's own surface
            return instance_ids
        owners: NDArray[np.int64] = _image_kernels.owners_of_depth(depth, depth_true, instance_ids, OFF, REACH)
        return owners

    def close(self) -> None:
        """Free the GL context of backend ``egl``; the other backends hold nothing."""
        if self._egl is not None:
            self._egl.close()

    def _photograph(
        self, hits: Hits, view: View, looks: tuple[Appearance, Light], rng: np.random.Generator
    ) -> NDArray[np.uint8]:
        """Return the grey image under an appearance that is not clean; outside the region it is the background's."""
        appearance, light = looks
        is_part = self._instances[hits.geom_at] >= 0
        albedo = light.albedo(is_part)
        albedo *= np.where(is_part, appearance.part_brightness, appearance.container_brightness).astype(np.float32)
        if appearance.labelled > 0:
            pixels = part_pixels(hits.geom_at, self._instances)
            albedo = label_albedo(albedo, hits, view, pixels, self._model.geom_aabb, appearance)
        grey = light.shade_albedo(hits.depth.astype(np.float32), hits.normals, np.minimum(albedo, 1), self.K)
        seen = photograph(grey, hits.normals, is_part, view, looks, rng)
        return np.where(hits.depth > 0, seen, np.uint8(light.background))

    def _render(self, data: mujoco.MjData) -> tuple[Hits, View]:
        """Return the first surface behind each pixel, and the view that was rendered."""
        if data.geom_xpos.shape[0] != self._model.ngeom:
            raise ValueError(f"data has {data.geom_xpos.shape[0]} geoms, the camera's model {self._model.ngeom}")
        size = (self.config.width, self.config.height)
        region = bin_region(self.workspace, self.K, self.T_world_cam, size, margin=MARGIN, headroom=HEADROOM)
        rotations, positions = geoms_in_camera(self._model, data, self._geoms, self.T_world_cam)
        view = View(K=self.K, width=size[0], height=size[1], region=region, rotations=rotations, positions=positions)
        if self._rays is not None:
            return self._raster.smooth(view, self._rays.cast(view)), view
        if self._egl is None:
            return self._raster.draw(view), view
        hits = self._egl.render(data, view, self.T_world_cam)
        # Where the raster sees another geom than GL, on outlines, the surface is taken to face the camera.
        hits.normals[hits.geom_at >= 0] = _TO_EYE
        return self._raster.smooth(view, hits), view


def default_pose(workspace: Workspace, distance: float) -> Floats:
    """Return ``T_world_cam`` (4, 4) straight above the bin: image x along the bin's x, the optical axis along its -z.

    Args:
        workspace: Pose and inner box of the bin.
        distance: Distance of the camera from the bin's inner floor [m].
    """
    return workspace.T_world_bin @ make_transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, distance))


@lru_cache(maxsize=64)
def _say_what_is_unseen(config: CameraConfig, length: float, width: float, height: float) -> None:
    """Log, once for a camera and a bin, that the bin's rim does not fit into the image.

    Args:
        config: Camera, straight above the bin.
        length: Length inside the bin, along the image's x axis [m].
        width: Width inside the bin [m].
        height: Height inside the bin [m].
    """
    to_rim = config.distance - height
    sides = (length * config.focal_px / config.width, width * config.focal_px / config.height)
    needed = height + max(sides)
    if to_rim < max(sides):
        log.warning(
            "a bin of %g x %g x %g mm lies partly outside the image of a camera %g m above its floor: its rim is seen "
            "from %.2f m on (--camera-distance, in Python camera_distance=)",
            *(1000 * side for side in (length, width, height)),
            config.distance,
            math.ceil(100 * needed) / 100,  # a distance to be followed, which rounding down would put too near
        )
