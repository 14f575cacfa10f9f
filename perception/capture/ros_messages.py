"""Images, clouds and calibrations from messages of ROS, of either version."""

import re
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.capture.calibration import Calibration
from perception.capture.calibration_files import calibration_of
from perception.capture.cloud import Cloud
from perception.capture.colours import grey_of_packed
from perception.capture.images import grey_image
from perception.geometry import Floats

# Encodings of depth: REP 118's two, and the one that recordings of librealsense have.
DEPTH_ENCODINGS = {"16UC1": np.uint16, "32FC1": np.float32, "mono16": np.uint16}
_COLOURS: dict[str, tuple[Any, int, int | None]] = {  # type, channels, and conversion to OpenCV's order
    "mono8": (np.uint8, 1, None),
    "8UC1": (np.uint8, 1, None),
    "mono16": (np.uint16, 1, None),
    "16UC1": (np.uint16, 1, None),
    "bgr8": (np.uint8, 3, None),
    "8UC3": (np.uint8, 3, None),
    "rgb8": (np.uint8, 3, cv2.COLOR_RGB2BGR),
    "bgra8": (np.uint8, 4, None),
    "rgba8": (np.uint8, 4, cv2.COLOR_RGBA2BGRA),
}
GREY_ENCODINGS = frozenset(_COLOURS)  # encodings of grey and colour images
# sensor_msgs/PointField's datatypes
_FIELD_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_COMPRESSION_HEADER = 12  # bytes before the PNG of a compressedDepth message: its format and two parameters


def is_compressed_depth(message: Any) -> bool:
    """Return whether a CompressedImage is a depth image of ROS's image transport ``compressedDepth``."""
    return "compressedDepth" in str(getattr(message, "format", ""))


def depth_of(message: Any, topic: str) -> NDArray[np.generic]:
    """Return the (H, W) depth of an Image or a compressedDepth message, in its own unit.

    Raises:
        ValueError: The encoding is none of a depth image, or the message is damaged.
    """
    if is_compressed_depth(message):
        kind = str(message.format).split(";")[0].strip()
        png = bytes(message.data)[_COMPRESSION_HEADER:]
        image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED) if len(png) else None
        if kind not in ("16UC1", "mono16") or image is None or image.dtype != np.uint16:
            raise ValueError(f"{topic} must hold 16-bit PNG images, got {message.format!r}: record the raw images")
        return np.asarray(image)
    if hasattr(message, "format"):
        raise ValueError(f"{topic} must hold compressedDepth images, got compressed images of {message.format!r}")
    if message.encoding not in DEPTH_ENCODINGS:
        raise ValueError(f"{topic} must have the encoding 16UC1 or 32FC1 of depth, got {message.encoding!r}")
    return _pixels(message, DEPTH_ENCODINGS[message.encoding], 1, topic)[:, :, 0]


def grey_of(message: Any, topic: str) -> NDArray[np.uint8]:
    """Return the (H, W) uint8 grey image of an Image or CompressedImage.

    Raises:
        ValueError: The encoding is unknown, or the message is damaged.
    """
    if hasattr(message, "format"):
        image = cv2.imdecode(np.frombuffer(bytes(message.data), np.uint8), cv2.IMREAD_UNCHANGED)
        if image is None:
            raise ValueError(f"{topic} must hold JPEG or PNG images, got {message.format!r}")
        return grey_image(np.asarray(image), topic)
    if message.encoding not in _COLOURS:
        raise ValueError(f"{topic} must have one of the encodings {', '.join(_COLOURS)}, got {message.encoding!r}")
    kind, channels, conversion = _COLOURS[message.encoding]
    pixels = _pixels(message, kind, channels, topic)
    return grey_image(pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion)), topic)


def _pixels(message: Any, kind: Any, channels: int, topic: str) -> NDArray[Any]:
    """Return the (H, W, channels) pixels; rows may be longer than the image."""
    item = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.asarray(message.data, np.uint8)
    row = width * channels * item.itemsize
    if step < row or len(data) < height * step:
        raise ValueError(
            f"{topic} must have {height} rows of at least {row} bytes, got rows of {step} and {len(data)} bytes: the "
            "message is damaged"
        )
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row])
    pixels: NDArray[Any] = rows.view(item).reshape(height, width, channels).astype(kind)
    return pixels


def calibration_of_info(message: Any, topic: str, *, rectified: bool) -> Calibration:
    """Return the calibration of a CameraInfo, or of the text that librealsense writes in its place.

    Args:
        message: CameraInfo, or a String of ``key=value`` pairs separated by semicolons.
        topic: Name of its topic, for messages.
        rectified: Whether the images are rectified: then the projection matrix holds, and there is no distortion.

    Raises:
        ValueError: There is no camera matrix, or the image is binned or a region of the sensor.
    """
    if hasattr(message, "data"):
        pairs = dict(pair.split("=", 1) for pair in str(message.data).split(";") if "=" in pair)
        values: dict[str, Any] = {**pairs, "coeffs": [float(each) for each in pairs.get("coeffs", "0").split(",")]}
        values.update({key: float(pairs[key]) for key in ("fx", "fy", "ppx", "ppy") if key in pairs})
        return calibration_of(_in_opencvs_length(values), topic)
    window = message.roi
    if max(message.binning_x, message.binning_y) > 1 or window.x_offset or window.y_offset:
        raise ValueError(f"{topic} must be of a whole image without binning, got binning or a region of interest")
    K, P = (_array(message, name) for name in ("k", "p"))
    D = _array(message, "d")
    if rectified and P.size == 12 and P[0] > 0:
        K, D = P.reshape(3, 4)[:, :3], np.zeros(0)
    return calibration_of(
        {
            "K": K.reshape(-1).tolist(),
            "D": D.tolist(),
            "distortion_model": message.distortion_model,
            "width": message.width,
            "height": message.height,
        },
        topic,
    )


def size_of_info(message: Any) -> tuple[int, int] | None:
    """Return the width and height of the images [px] that a CameraInfo or the text of librealsense is of.

    They are those of the region of the sensor, divided by the binning. None stands for a size that is not stated.
    """
    if hasattr(message, "data"):
        found = [re.search(rf"(?:^|;){side}=(\d+)", str(message.data)) for side in ("width", "height")]
        width, height = (int(each[1]) if each else 0 for each in found)
    else:
        width = (message.roi.width or message.width) // max(message.binning_x, 1)
        height = (message.roi.height or message.height) // max(message.binning_y, 1)
    return (int(width), int(height)) if width and height else None


def _array(message: Any, name: str) -> Floats:
    """Return the numbers of a CameraInfo, whose names are capitals in ROS 1."""
    return np.asarray(getattr(message, name, getattr(message, name.upper(), ())), np.float64).reshape(-1)


def _in_opencvs_length(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values of a calibration without coefficients if all of them are zero, however many there are."""
    return {**values, "coeffs": values["coeffs"] if any(values["coeffs"]) else []}


def cloud_of(message: Any, topic: str) -> Cloud:
    """Return the cloud of a PointCloud2, organised if its height exceeds 1; only x, y and z say what is measured.

    Raises:
        ValueError: There are no coordinates, or the message is damaged.
    """
    order = ">" if message.is_bigendian else "<"
    fields = {field.name: field for field in message.fields}
    if not {"x", "y", "z"} <= set(fields):
        raise ValueError(f"{topic} must have the fields x, y and z, got {', '.join(fields) or 'none'}")
    names = [name for name in ("x", "y", "z", "rgb", "rgba") if name in fields]
    kinds = [order + ("u4" if name in ("rgb", "rgba") else _FIELD_TYPES[fields[name].datatype]) for name in names]
    offsets = [int(fields[name].offset) for name in names]
    dtype = np.dtype({"names": names, "formats": kinds, "offsets": offsets, "itemsize": int(message.point_step)})
    height, width, step = int(message.height), int(message.width), int(message.row_step)
    data = np.asarray(message.data, np.uint8)
    row = width * dtype.itemsize
    if step < row or len(data) < height * step:
        raise ValueError(f"{topic} must have {height} rows of {row} bytes, got {len(data)} bytes: it is damaged")
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row])
    table = rows.reshape(-1).view(dtype).reshape(height, width)
    points = np.stack([table[name].astype(np.float64) for name in ("x", "y", "z")], axis=-1)
    colour = next((name for name in ("rgb", "rgba") if name in names), None)
    grey = None if colour is None else grey_of_packed(table[colour].astype(np.uint32).reshape(-1))
    return Cloud(points=points, grey=None if grey is None else grey.reshape(height, width))
