"""What the file of a frame holds: a depth image or a cloud, and whatever comes with it."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perception.capture.calibration import Calibration, require_pose
from perception.capture.calibration_files import calibration_of, depth_scale_of, states_camera
from perception.capture.cloud import Cloud
from perception.capture.damage import decoding, require_file
from perception.capture.images import grey_image, read_raw
from perception.capture.pcd import read_pcd
from perception.capture.ply import read_ply
from perception.capture.text_files import read_text
from perception.geometry import Floats
from perception.runtime.array_files import load_npz

POINT_KEYS = ("points", "xyz", "points_cam", "cloud")  # names of an organised cloud in an NPZ file
# Names of a grey or colour image in an NPZ file.
GREY_KEYS = ("grey", "gray", "image", "color", "colour", "rgb", "colors", "colours")
SMALL = 64  # arrays of an NPZ file that state a calibration have at most so many values

TABLE_COLUMNS = (3, 4, 6)  # columns of a table of points: x, y and z, perhaps with an intensity, or a colour or normal


@dataclass(frozen=True, eq=False, kw_only=True)
class Content:
    """Content of the file of a frame: either a depth image or a cloud.

    Attributes:
        depth: (H, W) depth as stored; None if the file holds a cloud.
        cloud: Points; None if the file holds a depth image.
        grey: (H, W) uint8 grey image; None if there is none.
        calibration: Calibration that the file holds; None if it holds none.
        depth_scale: Length of one unit of the depth [m] that the file states apart from its calibration; None if it
            states none.
        T_world_cam: (4, 4) camera pose that the file states apart from a calibration; None if it states none.
    """

    depth: NDArray[np.generic] | None = None
    cloud: Cloud | None = None
    grey: NDArray[np.uint8] | None = None
    calibration: Calibration | None = None
    depth_scale: float | None = None
    T_world_cam: Floats | None = None


def load_content(path: Path) -> Content:
    """Read a file of any of the formats.

    Args:
        path: PNG, TIFF, EXR, NPY, NPZ, PCD, PLY, or the JSON file that :func:`write_frame` writes.

    Raises:
        FileNotFoundError: There is no such file.
        IsADirectoryError: It is a folder.
        ValueError: The content is not what its suffix says.
    """
    require_file(path)
    with decoding(path):
        return _decoded(path, path.suffix.lower())


def _decoded(path: Path, suffix: str) -> Content:
    if suffix == ".pcd":
        return Content(cloud=read_pcd(path))
    if suffix == ".ply":
        return Content(cloud=read_ply(path))
    if suffix == ".npz":
        return _npz_content(path)
    if suffix == ".json":
        return _json_content(path)
    raw = read_raw(path)
    if raw.ndim == 3 and raw.shape[2] == 3 and raw.dtype.kind == "f":
        if (raw == raw[:, :, :1]).all():  # renderers store a depth image in every channel of an EXR
            return Content(depth=raw[:, :, 0])
        # Three floating-point channels are coordinates. OpenCV, which reads images, gives the first channel last.
        points = raw.astype(np.float64) if suffix == ".npy" else raw[:, :, ::-1].astype(np.float64)
        return Content(cloud=Cloud(points=points))
    if raw.ndim == 2 and raw.shape[1] == 3 and raw.dtype.kind == "f":  # no depth image has three columns
        return Content(cloud=Cloud(points=raw.astype(np.float64)[None]))
    if suffix == ".npy":
        _require_no_table(raw, path.name)
    return Content(depth=raw)


def _require_no_table(raw: NDArray[np.generic], name: str) -> None:
    """Raise ``ValueError`` if an array is a table of points rather than an image: no depth image is so narrow."""
    columns = raw.shape[-1] if raw.ndim == 2 or (raw.ndim == 3 and raw.shape[1] == 1) else 0
    if columns in TABLE_COLUMNS and len(raw) > columns:
        raise ValueError(
            f"{name} must be a depth image (H, W), or points (N, 3) or (H, W, 3) in floating point, got {raw.dtype} of "
            f"shape {raw.shape}, which looks like a table of points: save x, y and z alone in floating-point metres, "
            "or in floating point of another unit with scale (--depth-scale on the command line)"
        )


def _npz_content(path: Path) -> Content:
    arrays = load_npz(path)
    facts = {key: _plain(array) for key, array in arrays.items() if array.size <= SMALL and not _is_image(key)}
    calibration = calibration_of(facts, path.name) if states_camera(facts) else None
    pose = facts.get("T_world_cam")
    stated: dict[str, Any] = {
        "calibration": calibration,
        "depth_scale": depth_scale_of(facts) if calibration is None else None,
        "T_world_cam": require_pose("T_world_cam", pose) if calibration is None and pose is not None else None,
    }
    key = next((key for key in GREY_KEYS if key in arrays), None)
    if "depth" in arrays:
        return Content(depth=arrays["depth"], grey=None if key is None else _grey(arrays[key], key, path), **stated)
    points = next((arrays[key] for key in POINT_KEYS if key in arrays), None)
    if points is None:
        raise ValueError(
            f"{path.name} must hold 'depth' (H, W), or points (H, W, 3) as one of {POINT_KEYS}, got {sorted(arrays)}"
        )
    points = points.astype(np.float64)
    if points.ndim == 3:
        grey = None if key is None else _grey(arrays[key], key, path)
        return Content(cloud=Cloud(points=points), grey=grey, **stated)
    # Colours of points without a grid are projected with them.
    of_points = None if key is None else _grey(arrays[key][None], key, path)
    return Content(cloud=Cloud(points=points[None], grey=of_points), **stated)


def _is_image(key: str) -> bool:
    return key in ("depth", *POINT_KEYS, *GREY_KEYS)


def _plain(array: NDArray[Any]) -> Any:
    """Return an array as a list, or as a number or text if it holds one."""
    return array.item() if array.size == 1 else array.tolist()


def _grey(stored: NDArray[np.generic], key: str, path: Path) -> NDArray[np.uint8]:
    if stored.ndim == 3:
        stored = stored[:, :, :3][:, :, ::-1]  # arrays in Python are red first, images of OpenCV blue first
    return grey_image(stored, f"the image {key} in {path.name}")


def _json_content(path: Path) -> Content:
    facts = json.loads(read_text(path))
    if not (isinstance(facts, dict) and {"depth", "grey", "K"} <= set(facts)):
        raise ValueError(
            f"{path.name} must be a frame that write_frame wrote, with depth, grey and K: if it is a calibration, read "
            "the depth image and pass this file as calibration"
        )
    return Content(
        depth=read_raw(path.with_name(facts["depth"])),
        grey=grey_image(read_raw(path.with_name(facts["grey"]))),
        calibration=calibration_of(facts, path.name),
    )
