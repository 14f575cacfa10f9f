"""Live cameras: one method takes a frame, whoever made the camera.

RealSense cameras need pyrealsense2, which comes with the extra ``cameras``.
"""

import importlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from perception.capture.calibration import Calibration, require_pose
from perception.capture.calibration_files import calibration_of
from perception.capture.cloud import Cloud
from perception.capture.content import Content
from perception.capture.filling import fill_from_nearest
from perception.capture.images import grey_image
from perception.capture.options import ReadOptions
from perception.capture.reading import frame_of_content
from perception.frame import Frame
from perception.geometry import Floats, as_floats

_WAIT_MS = 5000  # longest wait for a frame of a RealSense camera [ms]


class Camera(Protocol):
    """Anything that takes frames."""

    def capture(self) -> Frame:
        """Take a frame."""
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class PointsCamera:
    """A camera whose driver returns organised clouds: (H, W, 3) arrays of points, as most 3D cameras' drivers do.

    Attributes:
        grab: Returns an (H, W, 3) array of points in the camera frame, NaN or zeros where nothing was measured, or a
            pair of it and a registered (H, W) grey or (H, W, 3) colour image, red first.
        calibration: Camera matrix of the points; None recovers it from each cloud.
        T_world_cam: (4, 4) camera pose, OpenCV axes; lists are accepted.
        options: Unit, axes, crop and turn of the clouds; ``scale=0.001`` for drivers that return millimetres.
    """

    grab: Callable[[], Any]
    calibration: Calibration | None = None
    T_world_cam: Floats = field(default_factory=lambda: np.eye(4))
    options: ReadOptions = field(default_factory=ReadOptions)

    def capture(self) -> Frame:
        """Take a frame.

        Raises:
            ValueError: The driver returned no (H, W, 3) points, or no camera matrix explains them.
        """
        grabbed = self.grab()
        points, image = grabbed if isinstance(grabbed, tuple) else (grabbed, None)
        points = as_floats("points", points)
        if points.ndim != 3 or points.shape[2] != 3 or min(points.shape[:2]) < 2:
            raise ValueError(
                f"grab must return an (H, W, 3) array of points, got {points.shape}: keep the image's grid"
            )
        grey = None
        if image is not None:
            image = np.asarray(image)
            grey = grey_image(image[:, :, 2::-1] if image.ndim == 3 and image.shape[2] >= 3 else image, "the image")
        frame, _ = frame_of_content(
            Content(cloud=Cloud(points=points), grey=grey),
            self.calibration,
            self.options,
            T_world_cam=require_pose("T_world_cam", self.T_world_cam),
        )
        return frame


class RealSenseCamera:
    """A RealSense camera, through pyrealsense2. The colour image is aligned to the depth image, which stays as it is.

    Attributes:
        T_world_cam: (4, 4) pose of the depth camera, OpenCV axes.
    """

    def __init__(self, next_frames: Callable[[], Any], *, T_world_cam: Floats | None = None) -> None:
        """Take frames from a source; :meth:`start` opens a camera.

        Args:
            next_frames: Returns a composite frame, as ``pyrealsense2.pipeline.wait_for_frames`` does.
            T_world_cam: (4, 4) pose of the depth camera; the identity if None.

        Raises:
            ModuleNotFoundError: The extra ``cameras`` is not installed.
        """
        self._rs = _pyrealsense2()
        self._next = next_frames
        self.T_world_cam: Floats = np.eye(4) if T_world_cam is None else require_pose("T_world_cam", T_world_cam)

    @classmethod
    def start(
        cls, *, serial: str | None = None, size: tuple[int, int] = (1280, 720), T_world_cam: Floats | None = None
    ) -> "RealSenseCamera":
        """Open a camera at 30 frames a second, with depth and colour of one size.

        Args:
            serial: Serial number; None for the first camera found.
            size: Width and height of both images [px].
            T_world_cam: (4, 4) pose of the depth camera; the identity if None.

        Raises:
            ModuleNotFoundError: The extra ``cameras`` is not installed.
            RuntimeError: No such camera is connected, or it has no such mode.
        """
        rs = _pyrealsense2()
        pipeline, config = rs.pipeline(), rs.config()
        if serial is not None:
            config.enable_device(serial)
        config.enable_stream(rs.stream.depth, *size, rs.format.z16, 30)
        config.enable_stream(rs.stream.color, *size, rs.format.rgb8, 30)
        pipeline.start(config)
        align = rs.align(rs.stream.depth)
        return cls(lambda: align.process(pipeline.wait_for_frames(_WAIT_MS)), T_world_cam=T_world_cam)

    def capture(self) -> Frame:
        """Take a frame.

        Raises:
            ValueError: There is no depth image, or its unit is not known: then all points would be at the origin.
        """
        frames = self._next()
        depth = frames.get_depth_frame()
        if not depth:
            raise ValueError("the camera must send depth images, got none: enable its depth stream")
        unit = float(depth.get_units())
        if not unit > 0:
            raise ValueError(
                f"the depth image must have a unit in metres, got {unit:g}: set the option depth_units of the sensor "
                "(rs.option.depth_units), which software devices lack"
            )
        stored = np.array(depth.get_data(), np.uint16)
        content = Content(depth=stored, grey=self._grey(frames, stored))
        calibration = self._calibration(depth, unit)
        return frame_of_content(content, calibration, ReadOptions(), T_world_cam=self.T_world_cam)[0]

    def _calibration(self, depth: Any, unit: float) -> Calibration:
        lens = depth.profile.as_video_stream_profile().intrinsics
        values = {name: getattr(lens, name) for name in ("width", "height", "fx", "fy", "ppx", "ppy")}
        values |= {"coeffs": list(lens.coeffs), "model": str(lens.model), "depth_scale": unit}
        return calibration_of(values, "the depth camera")

    def _grey(self, frames: Any, depth: NDArray[np.uint16]) -> NDArray[np.uint8] | None:
        """Return the grey of the aligned colour image; None if there is no colour of the depth's size.

        Aligned images are black where nothing was measured. Those pixels take the grey of the nearest others.
        """
        colour = frames.get_color_frame()
        if not colour:
            return None
        pixels = np.array(colour.get_data())
        if pixels.shape[:2] != depth.shape:
            return None
        if colour.profile.format() == self._rs.format.rgb8:
            pixels = pixels[:, :, ::-1]
        measured = depth > 0
        grey = grey_image(np.ascontiguousarray(pixels), "the colour image")
        return fill_from_nearest(grey, measured) if measured.any() else grey


def _pyrealsense2() -> Any:
    try:
        return importlib.import_module("pyrealsense2")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            'a RealSense camera needs pyrealsense2: pip install "binpick[cameras]"; recordings and exported images '
            "need it not, see read_frame"
        ) from error
    except ImportError as error:
        raise ImportError(
            f"a RealSense camera needs pyrealsense2, which is installed but cannot be loaded: {error}. A library "
            "of the system that it needs is missing; libusb comes with apt install libusb-1.0-0. Recordings and "
            "exported images need it not, see read_frame"
        ) from error
