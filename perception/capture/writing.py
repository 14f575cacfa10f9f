"""Frames to files that :func:`perception.capture.read_frame` reads."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.frame import Frame
from perception.runtime.files import json_text, replace_atomically, write_atomically, write_bytes_atomically

VERSION = 1  # version of the JSON file's keys
MOST = 65534  # largest stored depth; 65535 means "no measurement" to many programs


def write_frame(frame: Frame, path: str | Path, *, scale: float = 0.0001) -> None:
    """Write a frame, either exactly or as images.

    An NPZ file holds the arrays bit for bit. A JSON file holds the camera, beside ``NAME_depth.png`` (16 bits) and
    ``NAME_grey.png``; depths are rounded to whole units.

    Args:
        frame: Frame to write.
        path: File that ends in ``.npz`` or ``.json``; folders that are missing are created.
        scale: Length of one unit of the depth image [m]; the default reaches 6.55 m.

    Raises:
        ValueError: The suffix is another one, or the depths do not fit the unit.
    """
    path = Path(path)
    if path.suffix == ".npz":
        replace_atomically(path, lambda draft: _write_npz(frame, draft))
    elif path.suffix == ".json":
        _write_images(frame, path, scale)
    else:
        raise ValueError(f"path must end in .npz (exact) or .json (with PNG images), got {path.name!r}")


def _write_npz(frame: Frame, draft: Path) -> None:
    with draft.open("wb") as file:
        np.savez_compressed(file, depth=frame.depth, grey=frame.grey, K=frame.K, T_world_cam=frame.T_world_cam)


def _write_images(frame: Frame, path: Path, scale: float) -> None:
    if not 0 < scale < np.inf:
        raise ValueError(f"scale must be a positive length [m] per unit, got {scale}")
    units = np.rint(frame.depth.astype(np.float64) / scale)
    lost = frame.valid & (units == 0)
    if units.max(initial=0) > MOST or lost.any():
        valid = frame.depth[frame.valid]
        raise ValueError(
            f"depths of {valid.min():.4g} to {valid.max():.4g} m must be 1 to {MOST} units, got a unit of {scale:g} m: "
            f"set scale to at least {valid.max() / MOST:.3g} and at most twice the smallest depth"
        )
    names = {kind: f"{path.stem}_{kind}.png" for kind in ("depth", "grey")}
    _write_png(path.with_name(names["depth"]), units.astype(np.uint16))
    _write_png(path.with_name(names["grey"]), frame.grey)
    height, width = frame.depth.shape
    facts = {
        "version": VERSION,
        **names,
        "width": width,
        "height": height,
        "metres_per_unit": scale,
        "K": frame.K.tolist(),
        "T_world_cam": frame.T_world_cam.tolist(),
    }
    write_atomically(path, json_text(facts))


def _write_png(path: Path, image: NDArray[np.generic]) -> None:
    _, encoded = cv2.imencode(".png", np.ascontiguousarray(image))
    write_bytes_atomically(path, encoded.tobytes())
