"""Depth, grey and colour images from files."""

import logging
import os
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.frame import FARTHEST
from perception.runtime.array_files import load_npy

EXR = "OPENCV_IO_ENABLE_OPENEXR"  # environment variable without which OpenCV reads no EXR
FLOATING_SCALE = 1.0  # floating-point images are in metres unless stated otherwise [m]
INTEGER_SCALE = 0.001  # integer images are in millimetres unless stated otherwise [m]
_log = logging.getLogger(__name__)


def read_raw(path: Path) -> NDArray[np.generic]:
    """Return the pixels of an image or of an NPY file as they are stored.

    Args:
        path: PNG, TIFF, EXR, NPY, or another file that OpenCV reads. Colours are in OpenCV's order, blue first.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file cannot be decoded.
    """
    if path.suffix.lower() == ".npy":
        return load_npy(path)
    if path.suffix.lower() == ".exr":
        _require_exr(path)
    encoded = np.frombuffer(path.read_bytes(), np.uint8)
    image = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED) if len(encoded) else None
    if image is None:
        raise ValueError(f"{path.name} must be an image that OpenCV reads, got {len(encoded)} bytes: is it complete?")
    return np.asarray(image)


def _require_exr(path: Path) -> None:
    """Raise ``ValueError`` if this OpenCV reads no EXR."""
    if os.environ.get(EXR, "").lower() not in ("1", "true") or not cv2.haveImageWriter(path.name):
        raise ValueError(
            f"{path.name} must be read by an OpenCV with OpenEXR, with the environment variable {EXR}=1 set before "
            f"Python starts; this is OpenCV {cv2.__version__} with {EXR}={os.environ.get(EXR)}: convert the image to a "
            "floating-point TIFF or NPY, or install a build with OpenEXR"
        )


def metres(
    raw: NDArray[np.generic], scale: float | None, missing: tuple[float, ...], name: str = "the depth image"
) -> NDArray[np.float32]:
    """Return the (H, W) float32 depth [m], 0 where there is no measurement.

    Args:
        raw: (H, W) depth as stored, 16-bit or larger integers or floating point.
        scale: Length of one unit [m]; None for millimetres in integers and metres in floating point.
        missing: Stored values that mean "no measurement"; NaN, infinities, negative values and depths of at least
            `FARTHEST` always do.
        name: Name of the image, for messages.

    Raises:
        ValueError: The image has colours or 8 bits only.
    """
    if raw.ndim == 3 and raw.shape[2] == 1:
        raw = raw[:, :, 0]
    if raw.ndim != 2:
        raise ValueError(
            f"{name} must be (H, W), got {raw.shape}: this is a picture of a depth image; save the depth itself"
        )
    if raw.dtype in (np.uint8, np.int8, np.bool_) or raw.dtype.kind not in "uif":
        raise ValueError(
            f"{name} must have 16-bit or larger integers or floating point, got {raw.dtype}: save the depth itself"
        )
    if scale is None:
        scale = FLOATING_SCALE if raw.dtype.kind == "f" else INTEGER_SCALE
    stored = raw.astype(np.float64)
    values = np.array([value for value in missing if np.isfinite(value)], np.float64)
    if raw.dtype.kind == "f":
        values = values.astype(raw.dtype)  # as the file rounds them
    absent = ~np.isfinite(stored) | (stored <= 0) | np.isin(raw, values)
    far = ~absent & (stored >= FARTHEST / scale)
    if far.any() and (far | absent).all():
        _log.warning(
            "%s: all depths are %.0e m or more and count as missing: is scale right (0.001 for millimetres)? It is "
            "--depth-scale on the command line",
            name,
            FARTHEST,
        )
    absent |= far
    return (np.where(absent, 0.0, stored) * scale).astype(np.float32)


def grey_image(raw: NDArray[np.generic], name: str = "the grey image") -> NDArray[np.uint8]:
    """Return the (H, W) uint8 grey image of a grey or colour image.

    Colours are weighted by OpenCV. Of a 16-bit image, which often holds 10 or 12 bits, the lowest 8, 10, 12, 14 or 16
    bits that hold its largest value are mapped to 8.

    Args:
        raw: (H, W), (H, W, 3) or (H, W, 4) uint8 or uint16 image, blue first.
        name: Name of the image, for messages.

    Raises:
        ValueError: The image has another type or shape.
    """
    if raw.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{name} must be uint8 or uint16, got {raw.dtype}: save it with 8 bits a channel")
    if raw.dtype == np.uint16:
        bits = next(bits for bits in (8, 10, 12, 14, 16) if int(raw.max(initial=0)) < 2**bits)
        raw = (raw.astype(np.uint16) >> (bits - 8)).astype(np.uint8)
    if raw.ndim == 3 and raw.shape[2] == 1:
        raw = raw[:, :, 0]
    if raw.ndim == 2:
        return raw.astype(np.uint8)
    if raw.ndim == 3 and raw.shape[2] in (3, 4):
        code = cv2.COLOR_BGR2GRAY if raw.shape[2] == 3 else cv2.COLOR_BGRA2GRAY
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(raw), code), np.uint8)
    raise ValueError(f"{name} must be (H, W), (H, W, 3) or (H, W, 4), got {raw.shape}")
