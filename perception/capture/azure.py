"""The Azure Kinect's calibration: one for the whole sensor, from which each mode's follows."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from perception.capture.calibration import Calibration


@dataclass(frozen=True)
class _Mode:
    """Part of the sensor that a mode reads: size after binning, and first pixel of the crop [px]."""

    binned: tuple[int, int]
    crop: tuple[int, int]


# Source: Azure Kinect Sensor SDK, src/calibration and src/sdk/k4a.c, tables of the modes by the size of their images.
DEPTH_MODES = {
    (640, 576): _Mode((1024, 1024), (192, 180)),
    (320, 288): _Mode((512, 512), (96, 90)),
    (512, 512): _Mode((512, 512), (0, 0)),
    (1024, 1024): _Mode((1024, 1024), (0, 0)),
}
COLOUR_MODES = {
    (1280, 720): _Mode((1280, 960), (0, 120)),
    (1920, 1080): _Mode((1920, 1440), (0, 180)),
    (2560, 1440): _Mode((2560, 1920), (0, 240)),
    (2048, 1536): _Mode((2048, 1536), (0, 0)),
    (3840, 2160): _Mode((3840, 2880), (0, 360)),
    (4096, 3072): _Mode((4096, 3072), (0, 0)),
}
CAMERAS = (("CALIBRATION_CameraLocationD0", DEPTH_MODES), ("CALIBRATION_CameraLocationPV0", COLOUR_MODES))


def is_azure(content: Mapping[str, Any]) -> bool:
    """Return whether a JSON file is the calibration that an Azure Kinect stores."""
    return "CalibrationInformation" in content


def azure_calibration(content: Mapping[str, Any], size: tuple[int, int] | None) -> Calibration:
    """Return the calibration of one mode of an Azure Kinect.

    The size of the depth image tells the mode. An image of a colour camera's size was registered to that camera.

    Args:
        content: Content of the JSON file that the SDK or a recording holds.
        size: Width and height of the depth image [px].

    Raises:
        ValueError: No mode has images of this size, or the file lacks the camera.
    """
    cameras = {camera["Location"]: camera for camera in content["CalibrationInformation"]["Cameras"]}
    for location, modes in CAMERAS:
        if size in modes and location in cameras:
            return _calibration(cameras[location]["Intrinsics"]["ModelParameters"], modes[size], size)
    sizes = ", ".join(f"{width} x {height}" for _, modes in CAMERAS for width, height in modes)
    raise ValueError(
        f"an image of an Azure Kinect must have a mode's size ({sizes}), got {size} with the cameras "
        f"{sorted(cameras)}: state the calibration of a cropped or scaled image as K"
    )


def _calibration(parameters: list[float], mode: _Mode, size: tuple[int, int]) -> Calibration:
    """Return the calibration of the SDK's parameters, in units of the sensor's size, with corners at whole numbers."""
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, codx, cody, p2, p1 = parameters[:14]
    if codx or cody:
        raise ValueError(f"an Azure Kinect's centre of distortion must be 0, got {codx}, {cody}: rectify the images")
    width, height = mode.binned
    K = np.array(
        [
            [fx * width, 0, cx * width - mode.crop[0] - 0.5],
            [0, fy * height, cy * height - mode.crop[1] - 0.5],
            [0, 0, 1],
        ]
    )
    return Calibration(K=K, distortion=np.array([k1, k2, p1, p2, k3, k4, k5, k6]), size=size, depth_scale=0.001)
