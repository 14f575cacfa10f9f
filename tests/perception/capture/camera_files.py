"""Files of cameras, written byte by byte, and the small scene that they show."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, deproject_depth

WIDTH, HEIGHT = 8, 6
K = np.array([[20.0, 0.0, 3.4], [0.0, 21.0, 2.7], [0.0, 0.0, 1.0]])


def scene_depth() -> NDArray[np.float32]:
    """Return a (6, 8) depth image [m]: a slope with a step and two pixels without measurement."""
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    depth = 0.8 + 0.01 * u + 0.02 * v
    depth[2:4, 3:6] -= 0.1
    depth[0, 0] = depth[5, 7] = 0
    return depth.astype(np.float32)


def scene_points(dtype: Any = np.float64) -> NDArray[Any]:
    """Return the (6, 8, 3) organised cloud of the scene [m], NaN where nothing was measured."""
    points: Floats = deproject_depth(K, scene_depth().astype(np.float64))
    points[scene_depth() == 0] = np.nan
    return points.astype(dtype)


def pcd_header(fields: str, sizes: str, types: str, data: str, **changes: str) -> bytes:
    """Return the header of a PCD file of the scene's size; ``changes`` replace lines, None removes one."""
    lines = {
        "VERSION": "0.7",
        "FIELDS": fields,
        "SIZE": sizes,
        "TYPE": types,
        "COUNT": " ".join("1" for _ in fields.split()),
        "WIDTH": str(WIDTH),
        "HEIGHT": str(HEIGHT),
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": str(WIDTH * HEIGHT),
        "DATA": data,
    } | changes
    return ("# .PCD v0.7\n" + "".join(f"{key} {value}\n" for key, value in lines.items() if value)).encode()


def written(path: Path, content: bytes | str) -> Path:
    """Write a file and return its path."""
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path
