"""Frames from recordings: ROS 1 and ROS 2 bags, MCAP files, and what RealSense cameras record.

They need rosbags, which comes with the extra ``cameras``; it is imported only where a recording is read.
"""

import importlib.util
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perception.capture.calibration import Calibration
from perception.capture.content import Content
from perception.capture.ros_messages import (
    DEPTH_ENCODINGS,
    calibration_of_info,
    cloud_of,
    depth_of,
    grey_of,
    is_compressed_depth,
)

SUFFIXES = (".bag", ".mcap", ".db3")  # recordings in one file; a folder with metadata.yaml is one, too
_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_CLOUD, _INFO, _TEXT = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CameraInfo", "std_msgs/msg/String"
_TRANSPORTS = ("compressedDepth", "compressed", "zstd")  # last parts of the topics of compressed images
_REALSENSE = re.compile(r"^/device_\d+/sensor_\d+/")  # topics of librealsense's own recordings
_UNITS = re.compile(r"^/device_\d+/sensor_\d+/option/Depth[ _]Units/value$")


def is_recording(path: Path) -> bool:
    """Return whether a path names a recording: a file of one of the suffixes, or the folder of a ROS 2 bag."""
    return path.suffix.lower() in SUFFIXES or (path / "metadata.yaml").is_file()


def require_rosbags(path: Path) -> None:
    """Raise ``ModuleNotFoundError`` with advice unless recordings can be read."""
    if importlib.util.find_spec("rosbags") is None:
        raise ModuleNotFoundError(
            f'{path.name} needs rosbags, which reads ROS bags and MCAP: pip install "binpick[cameras]"'
        )


def recording_content(path: Path, index: int = 0, topic: str | None = None, grey_topic: str | None = None) -> Content:
    """Read one frame of a recording.

    The grey image is the nearest in time of a topic with images of the same size and the same frame of reference. Of
    recordings of librealsense none is taken unless it is named, since colour has a lens of its own and infrared shows
    the projected pattern.

    Args:
        path: ROS 1 bag, ROS 2 bag (folder or .db3), MCAP file, or a recording of librealsense (.bag, .db3).
        index: Number of the frame in the recording; negative ones count from the end.
        topic: Topic of the depth images or clouds; None for the only one.
        grey_topic: Topic of the grey or colour images; None for the one that is registered, if there is one.

    Raises:
        ModuleNotFoundError: The extra ``cameras`` is not installed.
        ValueError: The recording has no such frame or topic, or several and none is named.
    """
    with _opened(path) as reader:
        source = _chosen(reader, path, topic)
        message, time = _message(reader, source, index, path)
        if source.msgtype == _CLOUD:
            return Content(cloud=cloud_of(message, source.topic))
        depth = depth_of(message, source.topic)
        size = (depth.shape[1], depth.shape[0])
        return Content(
            depth=depth,
            grey=_grey(reader, source, message, time, grey_topic),
            calibration=_calibration(reader, source, size),
        )


def frame_count(path: Path, topic: str | None = None) -> int:
    """Return the number of depth images or clouds in a recording.

    Args:
        path: Recording of :func:`recording_content`.
        topic: Their topic; None for the only one.

    Raises:
        ModuleNotFoundError: The extra ``cameras`` is not installed.
        ValueError: The recording has no such topic, or several and none is named.
    """
    with _opened(path) as reader:
        return int(_chosen(reader, path, topic).msgcount)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    require_rosbags(path)
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        yield reader


def _chosen(reader: Any, path: Path, topic: str | None) -> Any:
    """Return the connection of the depth images or clouds; images are preferred to clouds of the same camera."""
    known = {each.topic: each for each in reader.connections}
    listed = ", ".join(f"{each.topic} ({each.msgtype.rsplit('/', 1)[-1]})" for each in reader.connections)
    if topic is not None:
        if topic not in known:
            raise ValueError(f"{path.name} must have the topic {topic}, got {listed or 'no topic'}")
        return known[topic]
    depths = [each for each in reader.connections if each.msgcount and _holds_depth(reader, each)]
    found = depths or [each for each in reader.connections if each.msgcount and each.msgtype == _CLOUD]
    if len(found) != 1:
        names = ", ".join(each.topic for each in found)
        what = f"the {len(found)} topics {names}: name one by topic" if found else f"only {listed or 'no topic'}"
        raise ValueError(f"{path.name} must have one topic of depth images or clouds, got {what}")
    return found[0]


def _holds_depth(reader: Any, connection: Any) -> bool:
    if connection.msgtype not in _IMAGES:
        return False
    message = _first(reader, connection)
    if connection.msgtype == _IMAGES[1]:
        return is_compressed_depth(message)
    # 16-bit grey images have the encoding mono16, too; only librealsense means depth by it.
    stated = message.encoding in DEPTH_ENCODINGS and message.encoding != "mono16"
    return stated or (message.encoding == "mono16" and "/Depth_" in connection.topic)


def _first(reader: Any, connection: Any) -> Any:
    _, _, raw = next(iter(reader.messages([connection])))
    return reader.deserialize(raw, connection.msgtype)


def _message(reader: Any, connection: Any, index: int, path: Path) -> tuple[Any, int]:
    count = int(connection.msgcount)
    if not -count <= index < count:
        raise ValueError(f"index must be one of the {count} frames of {path.name}, 0 to {count - 1}, got {index}")
    _, time, raw = next(islice(reader.messages([connection]), index % count, None))
    return reader.deserialize(raw, connection.msgtype), int(time)


def _grey(reader: Any, source: Any, depth: Any, time: int, topic: str | None) -> NDArray[np.uint8] | None:
    """Return the registered grey image that is nearest in time; None if there is none."""
    if topic is not None:
        found = [each for each in reader.connections if each.topic == topic and each.msgtype in _IMAGES]
        if not found:
            images = ", ".join(each.topic for each in reader.connections if each.msgtype in _IMAGES)
            raise ValueError(f"the recording must have images of the topic {topic}, got {images}")
        return grey_of(_nearest(reader, found[0], time), topic)
    if _REALSENSE.match(source.topic):
        return None
    others = [
        each
        for each in reader.connections
        if each.msgtype == _IMAGES[0] and each.msgcount and not _holds_depth(reader, each)
    ]
    registered = []
    for each in others:
        first = _first(reader, each)
        same_size = (first.height, first.width) == (getattr(depth, "height", 0), getattr(depth, "width", 0))
        if same_size and first.header.frame_id == depth.header.frame_id:
            registered.append(each)
    if len(registered) != 1:
        return None
    return grey_of(_nearest(reader, registered[0], time), registered[0].topic)


def _nearest(reader: Any, connection: Any, time: int) -> Any:
    best: tuple[int, bytes] | None = None
    for _, at, raw in reader.messages([connection]):
        if best is None or abs(at - time) < best[0]:
            best = (abs(at - time), bytes(raw))
        elif at > time:
            break
    if best is None:
        raise ValueError(f"the topic {connection.topic} must hold images, got none")
    return reader.deserialize(best[1], connection.msgtype)


def _calibration(reader: Any, source: Any, size: tuple[int, int]) -> Calibration | None:
    """Return the calibration of images of a size: that of the topic whose name begins most like theirs."""
    words = [word for word in source.topic.split("/") if word not in _TRANSPORTS]
    infos = [
        each
        for each in reader.connections
        if each.msgcount and (each.msgtype == _INFO or (each.msgtype == _TEXT and each.topic.endswith("/camera_info")))
    ]
    infos.sort(key=lambda each: (-_alike(words, each.topic.split("/")), each.msgtype != _INFO, each.topic))
    rectified = any("rect" in word for word in words)
    for each in infos:
        found = calibration_of_info(_first(reader, each), each.topic, rectified=rectified)
        if found.size in (None, size):
            scale = _depth_scale(reader)
            return found if scale is None else replace(found, depth_scale=scale)
    return None


def _alike(first: Iterable[str], second: Iterable[str]) -> int:
    """Return the number of words that two topics begin with alike."""
    count = 0
    for a, b in zip(first, second, strict=False):
        if a != b:
            break
        count += 1
    return count


def _depth_scale(reader: Any) -> float | None:
    """Return the unit of depth that librealsense records [m]; None for other recordings, whose unit is ROS's."""
    for each in reader.connections:
        if each.msgcount and _UNITS.match(each.topic):
            return float(_first(reader, each).data)
    return None
