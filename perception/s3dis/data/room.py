"""A labelled room of S3DIS, and its file."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, require_shape
from perception.runtime.job_files import find_files
from perception.runtime.records import RecordError, RecordFormat
from perception.s3dis.data.categories import CATEGORIES

ROOMS_NOTE = "rooms.json"  # file beside the rooms of a folder with their provenance
_NAME = re.compile(r"Area_(\d+)/[^/]+")


class RoomError(RecordError):
    """A file does not hold a complete room of this version."""


FORMAT = RecordFormat(kind="room", version=1, remedy="s3dis prepare makes rooms", error=RoomError)


@dataclass(frozen=True, eq=False, kw_only=True)
class Room:
    """The points of a room of S3DIS, and the ground truth.

    Attributes:
        name: Name of the room, such as "Area_5/office_1".
        xyz: (N, 3) float32 points in the building frame, z up [m].
        rgb: (N, 3) uint8 colours.
        semantic: (N,) uint8 category of each point, an index into ``CATEGORIES``.
        instance: (N,) int32 object of each point, 0 to P - 1; every point has one.
        source: Digest of the raw files of the room.
        remarks: Irregularities of the raw files.
    """

    name: str
    xyz: NDArray[np.float32]
    rgb: NDArray[np.uint8]
    semantic: NDArray[np.uint8]
    instance: NDArray[np.int32]
    source: str = ""
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise ValueError(f"name must be Area_NUMBER/ROOM, got {self.name!r}")
        require_shape("xyz", self.xyz, (None, 3))
        require_shape("rgb", self.rgb, (len(self.xyz), 3))
        for name, dtype in (("semantic", np.uint8), ("instance", np.int32)):
            array = getattr(self, name)
            require_shape(name, array, (len(self.xyz),))
            if array.dtype != dtype:
                raise ValueError(f"{name} must be {np.dtype(dtype)}, got {array.dtype}")
        if not len(self.xyz):
            raise ValueError(f"room {self.name} has no points")
        if self.semantic.max() >= len(CATEGORIES) or self.instance.min() < 0:
            raise ValueError(
                f"semantic must be below {len(CATEGORIES)} and instance not negative, "
                f"got {self.semantic.max()} and {self.instance.min()}"
            )

    def __len__(self) -> int:
        return len(self.xyz)

    @property
    def area(self) -> int:
        """Number of the area, 1 to 6."""
        return area_of(self.name)

    def category_of_instance(self) -> NDArray[np.int64]:
        """Return the (P,) category of each object, which is that of its first point; 0 for an id without points."""
        ids, first = np.unique(self.instance, return_index=True)
        categories = np.zeros(int(self.instance.max()) + 1, np.int64)
        categories[ids] = self.semantic[first]
        return categories

    def save(self, path: Path) -> None:
        """Write an uncompressed file of 20 bytes per point, atomically."""
        arrays: dict[str, Any] = {
            "name": np.str_(self.name),
            "source": np.str_(self.source),
            "remarks": np.array(self.remarks, np.str_),
            "xyz": self.xyz,
            "rgb": self.rgb,
            "semantic": self.semantic,
            "instance": self.instance,
        }
        FORMAT.save_arrays(path, arrays, compressed=False)

    @classmethod
    def load(cls, path: Path) -> "Room":
        """Read a room.

        Raises:
            RoomError: The file is missing, damaged, or of another kind or version.
        """
        return FORMAT.load_arrays(path, cls._from_arrays)

    @classmethod
    def _from_arrays(cls, arrays: dict[str, NDArray[Any]]) -> "Room":
        return cls(
            name=str(arrays["name"]),
            xyz=arrays["xyz"],
            rgb=arrays["rgb"],
            semantic=arrays["semantic"],
            instance=arrays["instance"],
            source=str(arrays["source"]),
            remarks=tuple(arrays["remarks"].tolist()),
        )


def area_of(name: str) -> int:
    """Return the number of the area in the name of a room."""
    found = _NAME.fullmatch(name)
    if found is None:
        raise ValueError(f"name must be Area_NUMBER/ROOM, got {name!r}")
    return int(found[1])


def room_path(folder: Path, name: str) -> Path:
    """Return the path of the file of a room, such as ``folder/Area_5/office_1.npz``."""
    return folder / f"{name}.npz"


def find_rooms(folder: Path, areas: Sequence[int] | None = None) -> list[Path]:
    """Return the files of the prepared rooms, in order.

    Args:
        folder: Folder of the rooms.
        areas: Numbers of the areas; all unless given.

    Raises:
        FileNotFoundError: There are no such rooms.
    """
    found = find_files(folder, "Area_*/*.npz")
    wanted = [path for path in found if areas is None or path.parent.name in {f"Area_{area}" for area in areas}]
    if not wanted:
        which = "" if areas is None else " of area " + ", ".join(str(area) for area in areas)
        raise FileNotFoundError(f"{folder} holds no room{which}; make some with s3dis.py prepare --out {folder}")
    return wanted


def mean_sizes(rooms: Iterable[Room]) -> Floats:
    """Return the (C,) mean number of points of an object of each category; 0 for a category without objects."""
    points, objects = np.zeros(len(CATEGORIES)), np.zeros(len(CATEGORIES))
    for room in rooms:
        points += np.bincount(room.semantic, minlength=len(CATEGORIES))
        present = np.unique(room.instance)
        objects += np.bincount(room.category_of_instance()[present], minlength=len(CATEGORIES))
    return np.divide(points, objects, out=np.zeros(len(CATEGORIES)), where=objects > 0)
