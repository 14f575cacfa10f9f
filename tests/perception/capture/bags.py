"""Recordings that rosbags writes, as test doubles of those of a camera."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

Kind = Literal["ros1", "sqlite3", "mcap"]
K = np.array([[60.0, 0, 31.5], [0, 61.0, 23.5], [0, 0, 1]])
Entry = tuple[str, int, Any]  # topic, time [ns], message


class Messages:
    """Makes messages of one version of ROS."""

    def __init__(self, kind: Kind) -> None:
        self.kind = kind
        self.store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)

    def header(self, frame: str = "camera") -> Any:
        types = self.store.types
        stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
        sequence = {"seq": 0} if self.kind == "ros1" else {}
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **sequence)

    def image(
        self, pixels: NDArray[Any], encoding: str, *, padding: int = 0, big: bool = False, frame: str = "camera"
    ) -> Any:
        height, width = pixels.shape[:2]
        rows = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder(">" if big else "<")))
        data = rows.view(np.uint8).reshape(height, -1)
        data = np.hstack([data, np.full((height, padding), 7, np.uint8)])
        return self.store.types["sensor_msgs/msg/Image"](
            header=self.header(frame), height=height, width=width, encoding=encoding, is_bigendian=int(big),
            step=data.shape[1], data=data.reshape(-1),
        )  # fmt: skip

    def info(self, size: tuple[int, int] = (64, 48), *, camera: NDArray[Any] = K, **changes: Any) -> Any:
        types = self.store.types
        offsets = {name: changes.pop(name, 0) for name in ("x_offset", "y_offset")}
        region = types["sensor_msgs/msg/RegionOfInterest"](height=0, width=0, do_rectify=False, **offsets)
        P = np.zeros((3, 4))
        P[:, :3] = changes.pop("projection", camera)
        names = ("D", "K", "R", "P") if self.kind == "ros1" else ("d", "k", "r", "p")
        arrays = (changes.pop("distortion", np.zeros(5)), camera.reshape(-1), np.eye(3).reshape(-1), P.reshape(-1))
        return types["sensor_msgs/msg/CameraInfo"](
            header=self.header(), height=size[1], width=size[0],
            distortion_model=changes.pop("distortion_model", "plumb_bob"),
            binning_x=changes.pop("binning_x", 0), binning_y=changes.pop("binning_y", 0), roi=region,
            **dict(zip(names, arrays, strict=True)),
        )  # fmt: skip

    def text(self, text: str) -> Any:
        return self.store.types["std_msgs/msg/String"](data=text)

    def number(self, value: float) -> Any:
        return self.store.types["std_msgs/msg/Float32"](data=value)

    def compressed(self, data: bytes, form: str) -> Any:
        types = self.store.types
        return types["sensor_msgs/msg/CompressedImage"](
            header=self.header(), format=form, data=np.frombuffer(data, np.uint8)
        )

    def cloud(self, table: NDArray[Any], *, padding: int = 0) -> Any:
        """Return a PointCloud2 of an (H, W) structured array."""
        types = self.store.types
        codes = {"f4": 7, "f8": 8, "u4": 6, "u2": 4}
        assert table.dtype.fields is not None
        fields = [
            types["sensor_msgs/msg/PointField"](name=name, offset=at, datatype=codes[kind.str[1:]], count=1)
            for name, (kind, at, *_) in table.dtype.fields.items()
        ]
        height, width = table.shape
        data = np.ascontiguousarray(table).view(np.uint8).reshape(height, -1)
        data = np.hstack([data, np.full((height, padding), 7, np.uint8)])
        return types["sensor_msgs/msg/PointCloud2"](
            header=self.header(), height=height, width=width, fields=fields, is_bigendian=False,
            point_step=table.dtype.itemsize, row_step=data.shape[1], data=data.reshape(-1), is_dense=False,
        )  # fmt: skip

    def write(self, path: Path, entries: Sequence[Entry], *, nodes: int = 1, empty: Sequence[str] = ()) -> Path:
        """Write messages in the order of their times, and return what a user would name.

        Args:
            path: Bag of ROS 1, or folder of one of ROS 2.
            entries: Messages.
            nodes: Number of nodes that publish the messages of each topic in turn; more than one only in ROS 1.
            empty: Topics of images without any.
        """
        store = self.store
        writer: Any
        if self.kind == "ros1":
            writer = Writer1(path)
        else:
            plugin = StoragePlugin.MCAP if self.kind == "mcap" else StoragePlugin.SQLITE3
            writer = Writer2(path, version=9, storage_plugin=plugin)
        with writer:
            for topic in empty:
                writer.add_connection(topic, "sensor_msgs/msg/Image", typestore=store)
            connections: dict[tuple[str, int], Any] = {}
            written: Counter[str] = Counter()
            for topic, time, message in sorted(entries, key=lambda entry: entry[1]):
                kind, key = message.__msgtype__, (topic, written[topic] % nodes)
                written[topic] += 1
                if key not in connections:
                    caller = {"callerid": f"/node_{key[1]}"} if self.kind == "ros1" else {}
                    connections[key] = writer.add_connection(topic, kind, typestore=store, **caller)
                raw = store.serialize_ros1(message, kind) if self.kind == "ros1" else store.serialize_cdr(message, kind)
                writer.write(connections[key], time, raw)
        return path
