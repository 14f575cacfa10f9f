"""Pictures of a scene: image, boundary points, truth and prediction; a prediction has the colour of its part."""

import colorsys
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from binpick_env.evaluation.segmentation.record import SceneRecord
from perception.metrics.matching import instance_ious
from perception.segmentation.scoring import COUNTED_FROM

WIDTH = 640  # largest width of a picture [px]
MATCHED = 0.5  # IoU over which a prediction matches a part; at most one prediction of a part can exceed it
JPEG_QUALITY = 80
Colours = NDArray[np.uint8]

_PAPER, _POINT, _UNCOUNTED = (24, 20, 18), (225, 222, 216), (105, 98, 92)  # BGR
_WRONG = ((50, 50, 235), (245, 245, 245))  # red and white
_STRIPE = 6  # width of a stripe [px]


class Panel(NamedTuple):
    """One encoded picture of a scene."""

    name: str  # title of the picture
    kind: str  # "jpeg" or "png"
    data: bytes  # content of the file


def scene_panels(record: SceneRecord) -> list[Panel]:
    """Return panels of the image (if the record has one), the boundary points, the truth and the prediction."""
    truth, prediction = truth_colours(record), prediction_colours(record)
    points = np.full((len(record.labels), 3), _POINT, np.uint8)
    panels = [
        Panel(name, "png", _encoded(".png", _scatter(record, colours)))
        for name, colours in (("boundary points", points), ("truth", truth), ("prediction", prediction))
    ]
    if record.picture.size:
        step = _step(record)
        small = cv2.resize(record.picture, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA)
        panels.insert(0, Panel("image", "jpeg", _encoded(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])))
    return panels


def side_by_side(record: SceneRecord) -> Colours:
    """Return one (h, w, 3) RGB picture: image (if the record has one), truth and prediction in a row."""
    pictures = [_scatter(record, colours) for colours in (truth_colours(record), prediction_colours(record))]
    if record.picture.size:
        size = (pictures[0].shape[1], pictures[0].shape[0])
        small = cv2.resize(record.picture, size, interpolation=cv2.INTER_AREA)
        pictures.insert(0, np.repeat(small[:, :, None], 3, axis=2))
    return np.ascontiguousarray(np.hstack(pictures)[:, :, ::-1])


def truth_colours(record: SceneRecord) -> Colours:
    """Return (N, 3) BGR colours of the points: one for each counted part, grey for other parts and the container."""
    table = np.vstack([part_colours(len(record.visible_fractions)), [_UNCOUNTED]]).astype(np.uint8)
    table[:-1][record.visible_fractions < COUNTED_FROM] = _UNCOUNTED
    return table[record.instance_ids]


def prediction_colours(record: SceneRecord) -> Colours:
    """Return (N, 3) BGR colours of the points by the predicted instance that they belong to.

    An instance has the colour of the part that it matches with an IoU over `MATCHED`, or red and white stripes without
    such a part. It is grey if it matches an uncounted part, or lies mostly on the container or on uncounted parts.
    Points without an instance are grey.
    """
    truth, instances = record.truth(), record.instances()
    ious = instance_ious(truth, instances)
    counted = np.append(~truth.ignored, False)
    colours = np.full((len(record.labels), 3), _UNCOUNTED, np.uint8)
    table = part_colours(len(truth.ignored))
    for k, instance in enumerate(instances):
        idx = instance.point_idx
        best = int(ious[k].argmax()) if ious.shape[1] else -1
        if best >= 0 and ious[k, best] > MATCHED:
            colours[idx] = table[best] if counted[best] else _UNCOUNTED
        elif counted[truth.instance_ids[idx]].mean() >= 0.5:
            stripes = record.pixels[idx].sum(axis=1) // (_STRIPE * _step(record)) % 2
            colours[idx] = np.array(_WRONG, np.uint8)[stripes]
    return colours


def part_colours(count: int) -> Colours:
    """Return (count, 3) BGR colours; successive hues are far apart, and none is the red of wrong predictions."""
    hues = (0.08 + 0.84 * (0.618034 * k % 1.0) for k in range(count))
    values = [colorsys.hsv_to_rgb(hue, (0.55, 0.8)[k % 2], 1.0)[::-1] for k, hue in enumerate(hues)]
    return (255 * np.array(values).reshape(-1, 3)).astype(np.uint8)


def _scatter(record: SceneRecord, colours: Colours) -> Colours:
    """Draw each point as one pixel on a dark background."""
    step = _step(record)
    origin, size = _extent(record)
    picture = np.full((-(-size[1] // step), -(-size[0] // step), 3), _PAPER, np.uint8)
    u, v = ((record.pixels - origin) // step).T
    picture[v, u] = colours
    return picture


def _step(record: SceneRecord) -> int:
    """Return the number of camera pixels per pixel of a picture."""
    return max(1, -(-_extent(record)[1][0] // WIDTH))


def _extent(record: SceneRecord) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Return the first pixel (u, v) that is shown, and width and height in camera pixels."""
    if record.picture.size:
        height, width = record.picture.shape
        return np.array(record.corner), (width, height)
    if len(record.pixels) == 0:
        return np.zeros(2, np.int64), (1, 1)
    low, high = record.pixels.min(axis=0), record.pixels.max(axis=0)
    return low, (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1)


def _encoded(suffix: str, picture: cv2.typing.MatLike, settings: list[int] | None = None) -> bytes:
    _, data = cv2.imencode(suffix, picture, settings or [])
    return data.tobytes()
