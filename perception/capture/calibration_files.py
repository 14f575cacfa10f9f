"""Calibrations from files: RealSense, Open3D, Azure Kinect, BOP, OpenCV, ROS, and those written beside frames."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from perception.capture.azure import azure_calibration, is_azure
from perception.capture.calibration import Calibration, pose_from_world_to_camera
from perception.capture.damage import decoding, require_file
from perception.capture.lens import distortion_of
from perception.capture.named_values import number_of, numbers_of
from perception.capture.text_files import read_text
from perception.capture.yaml_subset import parse_yaml
from perception.geometry import as_floats

# Lengths of units by their names [m].
_METRES = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("cm", "centimetre", "centimetres", "centimeter", "centimeters"), 0.01),
    **dict.fromkeys(("mm", "millimetre", "millimetres", "millimeter", "millimeters"), 0.001),
    **dict.fromkeys(("um", "\u00b5m", "\u03bcm", "micrometre", "micrometres", "micrometer", "micrometers"), 1e-6),
}
_LENGTH = re.compile(r"\s*(?P<number>[+-]?[0-9.][0-9.eE+-]*)?\s*(?P<unit>[^\W\d_]*)\s*")
_MATRICES = ("cam_K", "camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "k")  # names of a matrix row by row
FORMATS = (
    "RealSense (fx, fy, ppx, ppy), Open3D (intrinsic_matrix), Azure Kinect (CalibrationInformation), "
    "BOP (cam_K or fx, fy, cx, cy), OpenCV FileStorage (camera_matrix), ROS CameraInfo (K or k)"
)


def read_calibration(
    path: str | Path, *, image_id: int | None = None, size: tuple[int, int] | None = None
) -> Calibration:
    """Read the calibration of a camera from a JSON or YAML file.

    Args:
        path: File of RealSense, Open3D, the Azure Kinect, BOP (``camera.json``, ``scene_camera.json``), OpenCV or ROS.
        image_id: Number of the image in a file that holds several (BOP's ``scene_camera.json``).
        size: Width and height of the depth image [px]; the Azure Kinect's mode follows from it.

    Raises:
        FileNotFoundError: There is no such file.
        IsADirectoryError: It is a folder.
        ValueError: The file is none of these formats, or its lens model cannot be removed.
    """
    path = Path(path)
    require_file(path, "calibration")
    with decoding(path):
        return _decoded(path, image_id, size)


def _decoded(path: Path, image_id: int | None, size: tuple[int, int] | None) -> Calibration:
    text = read_text(
        path,
        kind="a calibration in JSON or YAML",
        advice="write the camera matrix as JSON, such as "
        '{"fx": 600, "fy": 600, "cx": 320, "cy": 240, "width": 640, "height": 480}',
    )
    if text.lstrip().startswith("<"):
        raise ValueError(f"{path.name} must be a calibration in JSON or YAML, got XML: write it with OpenCV as .yaml")
    content = json.loads(text) if path.suffix.lower() == ".json" else parse_yaml(text)
    if not isinstance(content, dict):
        raise ValueError(f"{path.name} must hold named values, got a {type(content).__name__}")
    if is_azure(content):
        return azure_calibration(content, size)
    return calibration_of(_chosen_entry(content, path.name, image_id), path.name)


def _chosen_entry(content: dict[str, Any], name: str, image_id: int | None) -> dict[str, Any]:
    """Return the entry of one image or stream of a file that holds several, otherwise the whole content."""
    images = {int(key): value for key, value in content.items() if key.isdigit() and isinstance(value, dict)}
    if images:
        if len(images) == 1 and image_id is None:
            return next(iter(images.values()))
        if image_id not in images:
            raise ValueError(
                f"image_id must be one of the {len(images)} images of {name}, {min(images)} to {max(images)}, "
                f"got {image_id}"
            )
        return images[image_id]
    for stream in ("depth", "depth_intrinsics", "intrinsics"):
        if isinstance(content.get(stream), dict):
            return {**content, **content[stream]}
    return content


def calibration_of(values: Mapping[str, Any], name: str = "the calibration") -> Calibration:
    """Return the calibration that a file's values describe.

    Args:
        values: Named values of one camera in any of the formats but the Azure Kinect's.
        name: Name of the file, for messages.

    Raises:
        ValueError: No camera matrix was found, or what is stated of the lens is not understood.
    """
    K = _camera_matrix(values)
    if K is None:
        raise ValueError(f"{name} must hold a camera matrix as one of {FORMATS}, got the keys {sorted(values)}")
    T_world_cam = values.get("T_world_cam")
    if T_world_cam is None and "cam_R_w2c" in values and "cam_t_w2c" in values:  # BOP, millimetres
        T_world_cam = pose_from_world_to_camera(values["cam_R_w2c"], as_floats("cam_t_w2c", values["cam_t_w2c"]) / 1000)
    return Calibration(
        K=K, distortion=distortion_of(values, name), size=_size(values), depth_scale=depth_scale_of(values),
        T_world_cam=T_world_cam,
    )  # fmt: skip


def states_camera(values: Mapping[str, Any]) -> bool:
    """Return whether values state a camera matrix, or part of one."""
    return any(values.get(key) is not None for key in (*_MATRICES, "intrinsic_matrix", "fx", "fy"))


def _camera_matrix(values: Mapping[str, Any]) -> Any:
    for key in _MATRICES:
        if values.get(key) is not None and np.size(numbers := numbers_of(values[key], key)) == 9:
            return numbers.reshape(3, 3)
    key = "intrinsic_matrix"
    if values.get(key) is not None and np.size(numbers := numbers_of(values[key], key)) == 9:
        return numbers.reshape(3, 3).T  # Open3D writes columns
    across, down = ("ppx" if "ppx" in values else "cx"), ("ppy" if "ppy" in values else "cy")
    if any(values.get(key) is None for key in ("fx", "fy", across, down)):
        return None
    fx, fy, cx, cy = (number_of(values[key], key) for key in ("fx", "fy", across, down))
    return [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]


def _size(values: Mapping[str, Any]) -> tuple[int, int] | None:
    for names in (("width", "height"), ("image_width", "image_height"), ("image_Width", "image_Height")):
        if all(values.get(key) is not None for key in names):
            return _pixels(values[names[0]], names[0]), _pixels(values[names[1]], names[1])
    return None


def _pixels(value: Any, key: str) -> int:
    length = number_of(value, key)
    if not length.is_integer():
        raise ValueError(f"{key} must be a whole number of pixels, got {value!r}")
    return int(length)


def depth_scale_of(values: Mapping[str, Any]) -> float | None:
    """Return the length of a unit of depth [m] that values state; None if they state none.

    ``depth_scale`` is the reciprocal in Open3D's files, and millimetres in BOP's. A unit by name, such as "mm" or
    "0.1 mm", says itself what it is.

    Args:
        values: Named values of one camera.

    Raises:
        ValueError: The unit is no positive length.
    """
    key = next((key for key in ("metres_per_unit", "depth_units", "depth_scale") if values.get(key) is not None), None)
    if key is None:
        return None
    if isinstance(values[key], str) and (named := _named_length(values[key], key)) is not None:
        return named
    scale = number_of(values[key], key)
    if not 0 < scale < np.inf:
        raise ValueError(f"{key} must be positive and finite, got {values[key]!r}")
    if key != "depth_scale" or "ppx" in values:  # RealSense's SDK states metres
        return scale
    return 1 / scale if "intrinsic_matrix" in values else scale / 1000


def _named_length(text: str, key: str) -> float | None:
    """Return a length [m] with the name of its unit, "mm" or "0.1 mm"; None for a number without one.

    Raises:
        ValueError: The text is neither.
    """
    found = _LENGTH.fullmatch(text)
    unit = "" if found is None else found["unit"].lower()
    if found is None or (unit and unit not in _METRES):
        raise ValueError(
            f"{key} must be a number, or a length such as 'mm' or '0.1 mm' in one of {', '.join(_METRES)}, got {text!r}"
        )
    if not unit:
        return None
    length = number_of(found["number"] or 1.0, key) * _METRES[unit]
    if not 0 < length < np.inf:
        raise ValueError(f"{key} must be positive and finite, got {text!r}")
    return length
