"""Frames from recordings: ROS 1 and ROS 2 bags, MCAP files, and what RealSense cameras record.

They need rosbags, which comes with the extra ``cameras``; it is imported only where a recording is read.
"""

import importlib.util
import logging
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perception.capture.calibration import Calibration
from perception.capture.content import Content
from perception.capture.ros_messages import (
    DEPTH_ENCODINGS,
    GREY_ENCODINGS,
    calibration_of_info,
    cloud_of,
    depth_of,
    grey_of,
    is_compressed_depth,
    size_of_info,
)

SUFFIXES = (".bag", ".mcap", ".db3")  # recordings in one file; a folder with metadata.yaml is one, too
_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_CLOUD, _INFO, _TEXT = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CameraInfo", "std_msgs/msg/String"
_REALSENSE = re.compile(r"^/device_\d+/sensor_\d+/")  # topics of librealsense's own recordings
_UNITS = re.compile(r"^/device_\d+/sensor_\d+/option/Depth[ _]Units/value$")
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Topic:
    """Topic of a recording, with all its connections: in a bag of ROS 1 each node that publishes has its own."""

    name: str
    msgtype: str
    count: int  # number of messages
    connections: tuple[Any, ...]


@dataclass(frozen=True, kw_only=True)
class _Registered:
    """What a grey image has in common with the depth image that it is registered to."""

    size: tuple[int, int]  # width and height [px]
    frame_id: str  # frame of reference
    encoding: str  # encoding of the depth image; empty if it is compressed
    time: int  # time of the recording [ns]; the grey image's may differ


def is_recording(path: Path) -> bool:
    """Return whether a path names a recording: a file of one of the suffixes, or the folder of a ROS 2 bag."""
    return path.suffix.lower() in SUFFIXES or (path / "metadata.yaml").is_file()


def require_rosbags(path: Path) -> None:
    """Raise ``ModuleNotFoundError`` with advice unless recordings can be read."""
    if importlib.util.find_spec("rosbags") is None:
        raise ModuleNotFoundError(
            f'{path.name} needs rosbags, which reads ROS bags and MCAP: pip install "binpick[cameras]"'
        )


def recording_content(
    path: Path,
    index: int = 0,
    topic: str | None = None,
    grey_topic: str | None = None,
    *,
    calibrated: bool = True,
    scaled: bool = True,
) -> Content:
    """Read one frame of a recording.

    The grey image is the nearest in time of another topic with uncompressed images of the same size and the same frame
    of reference; images of encodings that are not known are left out. Of recordings of librealsense none is taken
    unless it is named, since colour has a lens of its own and infrared shows the projected pattern.

    Args:
        path: ROS 1 bag, ROS 2 bag (folder or .db3), MCAP file, or a recording of librealsense (.bag, .db3).
        index: Number of the frame in the recording; negative ones count from the end.
        topic: Topic of the depth images or clouds; None for the only one.
        grey_topic: Topic of the grey or colour images of depth images; None for the one that is registered, if there is
            one.
        calibrated: Whether to read the calibration of the depth images; False where another one is used, so that one
            that cannot be used is no error.
        scaled: Whether to read the unit of the depth images; False where it is stated otherwise.

    Raises:
        ModuleNotFoundError: The extra ``cameras`` is not installed.
        ValueError: The recording has no such frame or topic, or several and none is named; or ``grey_topic`` is given
            for clouds.
    """
    with _opened(path) as reader:
        source = _chosen(reader, path, topic)
        message, time = _message(reader, source, index, path)
        if source.msgtype == _CLOUD:
            if grey_topic is not None:
                raise ValueError(
                    f"grey_topic must come with a topic of depth images, got the clouds of {source.name}, whose grey "
                    "is that of their points: leave grey_topic out, or name depth images by topic (--grey-topic and "
                    "--topic on the command line)"
                )
            return Content(cloud=cloud_of(message, source.name))
        depth = depth_of(message, source.name)
        frame = _Registered(
            size=(depth.shape[1], depth.shape[0]),
            frame_id=message.header.frame_id,
            encoding=getattr(message, "encoding", ""),
            time=time,
        )
        return Content(
            depth=depth,
            grey=_grey(reader, source, frame, grey_topic),
            calibration=_calibration(reader, source, frame.size) if calibrated else None,
            depth_scale=_depth_scale(reader, source) if scaled else None,
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
        return _chosen(reader, path, topic).count


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    require_rosbags(path)
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        yield reader


def _topics(reader: Any) -> list[_Topic]:
    """Return the topics, in the order of their first connections."""
    found: dict[tuple[str, str], list[Any]] = {}
    for each in reader.connections:
        found.setdefault((each.topic, each.msgtype), []).append(each)
    return [
        _Topic(name=name, msgtype=kind, count=sum(each.msgcount for each in ones), connections=tuple(ones))
        for (name, kind), ones in found.items()
    ]


def _chosen(reader: Any, path: Path, topic: str | None) -> _Topic:
    """Return the topic of the depth images or clouds; images are preferred to clouds of the same camera."""
    topics = _topics(reader)
    listed = ", ".join(f"{each.name} ({_short(each)})" for each in topics) or "no topic"
    if topic is not None:
        named = [each for each in topics if each.name == topic]
        if not named:
            raise ValueError(f"{path.name} must have the topic {topic}, got {listed}")
        usable = [each for each in named if each.msgtype in (*_IMAGES, _CLOUD)]
        if not usable:
            raise ValueError(
                f"the topic {topic} of {path.name} must hold depth images or clouds, got {_short(named[0])}: name "
                f"another one of {listed}"
            )
        return usable[0]
    depths = [each for each in topics if each.count and _holds_depth(reader, each)]
    found = depths or [each for each in topics if each.count and each.msgtype == _CLOUD]
    if len(found) != 1:
        names = ", ".join(each.name for each in found)
        what = f"the {len(found)} topics {names}: name one by topic" if found else f"only {listed}"
        raise ValueError(f"{path.name} must have one topic of depth images or clouds, got {what}")
    return found[0]


def _short(topic: _Topic) -> str:
    """Return the name of a topic's type without its package."""
    return topic.msgtype.rsplit("/", 1)[-1]


def _holds_depth(reader: Any, topic: _Topic) -> bool:
    if topic.msgtype not in _IMAGES:
        return False
    message = _first(reader, topic)
    if topic.msgtype == _IMAGES[1]:
        return is_compressed_depth(message)
    # 16-bit grey images have the encoding mono16, too; only librealsense means depth by it.
    stated = message.encoding in DEPTH_ENCODINGS and message.encoding != "mono16"
    return stated or (message.encoding == "mono16" and "/Depth_" in topic.name)


def _first(reader: Any, topic: _Topic) -> Any:
    _, _, raw = next(iter(reader.messages(topic.connections)))
    return reader.deserialize(raw, topic.msgtype)


def _message(reader: Any, topic: _Topic, index: int, path: Path) -> tuple[Any, int]:
    count = topic.count
    if count == 0:
        raise ValueError(f"the topic {topic.name} of {path.name} must hold depth images or clouds, got none")
    if not -count <= index < count:
        raise ValueError(f"index must be one of the {count} frames of {path.name}, 0 to {count - 1}, got {index}")
    _, time, raw = next(islice(reader.messages(topic.connections), index % count, None))
    return reader.deserialize(raw, topic.msgtype), int(time)


def _grey(reader: Any, source: _Topic, depth: _Registered, topic: str | None) -> NDArray[np.uint8] | None:
    """Return the registered grey image that is nearest in time; None if there is none.

    Images that cannot be read are left out, unless they are named.
    """
    if topic is not None:
        images = [each for each in _topics(reader) if each.msgtype in _IMAGES]
        found = [each for each in images if each.name == topic]
        if not found:
            names = ", ".join(each.name for each in images)
            raise ValueError(f"the recording must have images of the topic {topic}, got {names}")
        return grey_of(_nearest(reader, found[0], depth.time), topic)
    if _REALSENSE.match(source.name):
        return None
    registered = []
    for each in _topics(reader):
        if each.msgtype == _IMAGES[0] and each.count and each.name != source.name and not _holds_depth(reader, each):
            first = _first(reader, each)
            if (first.width, first.height) == depth.size and first.header.frame_id == depth.frame_id:
                if first.encoding not in GREY_ENCODINGS:
                    _log.info("%s is not taken as the grey image: its encoding is %s", each.name, first.encoding)
                elif first.encoding != "mono16" or depth.encoding != "mono16":  # otherwise it may be depth, too
                    registered.append(each)
    if len(registered) != 1:
        return None
    try:
        return grey_of(_nearest(reader, registered[0], depth.time), registered[0].name)
    except ValueError as error:
        _log.warning("there is no grey image: %s", error)
        return None


def _nearest(reader: Any, topic: _Topic, time: int) -> Any:
    best: tuple[int, bytes] | None = None
    for _, at, raw in reader.messages(topic.connections):
        if best is None or abs(at - time) < best[0]:
            best = (abs(at - time), bytes(raw))
        elif at > time:
            break
    if best is None:
        raise ValueError(f"the topic {topic.name} must hold images, got none")
    return reader.deserialize(best[1], topic.msgtype)


def _calibration(reader: Any, source: _Topic, size: tuple[int, int]) -> Calibration | None:
    """Return the calibration of images of a size: that of the topic whose name begins most like theirs.

    One of this size that cannot be used gives way only to one whose topic is as much like theirs: the others are those
    of other cameras.

    Raises:
        ValueError: None can be used; the message says that another one can take its place.
    """
    words = source.name.split("/")
    infos = [
        each
        for each in _topics(reader)
        if each.count and (each.msgtype == _INFO or (each.msgtype == _TEXT and each.name.endswith("/camera_info")))
    ]
    infos.sort(key=lambda each: (-_alike(words, each.name.split("/")), each.msgtype != _INFO, each.name))
    rectified = any("rect" in word for word in words)
    least = 0  # words that a topic must have in common with the images'
    refusal: ValueError | None = None
    for each in infos:
        alike, message = _alike(words, each.name.split("/")), _first(reader, each)
        if alike < least:
            break
        try:
            found = calibration_of_info(message, each.name, rectified=rectified)
        except ValueError as error:
            fits = size_of_info(message) in (None, size)
            if refusal is None or (fits and not least):
                refusal = error
            if fits:
                least = alike
            continue
        if found.size in (None, size):
            return found
    if refusal is not None:
        raise ValueError(
            f"{refusal}; to use another calibration of these images, pass it by calibration= (--calibration on the "
            "command line)"
        ) from refusal
    return None


def _alike(first: Iterable[str], second: Iterable[str]) -> int:
    """Return the number of words that two topics begin with alike."""
    count = 0
    for a, b in zip(first, second, strict=False):
        if a != b:
            break
        count += 1
    return count


def _depth_scale(reader: Any, source: _Topic) -> float | None:
    """Return the unit of depth that librealsense records [m]; None for other recordings, whose unit is ROS's.

    Of several sensors it is the unit of the one whose topics begin most like that of the depth images.

    Raises:
        ValueError: Several are as much like it, and differ.
    """
    words = source.name.split("/")
    topics = [each for each in _topics(reader) if each.count and _UNITS.match(each.name)]
    most = max((_alike(words, each.name.split("/")) for each in topics), default=0)
    units = {
        each.name: float(_first(reader, each).data) for each in topics if _alike(words, each.name.split("/")) == most
    }
    if len(set(units.values())) > 1:
        found = ", ".join(f"{unit:g} m in {name}" for name, unit in units.items())
        raise ValueError(
            f"the recording must state one unit of the depth in {source.name}, got {found}: pass the right one by "
            "scale= (--depth-scale on the command line)"
        )
    return next(iter(units.values()), None)
