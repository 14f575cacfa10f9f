"""Classes of parts by size in the image and by shape, within which perception is taken to err alike."""

from collections.abc import Sequence
from itertools import product
from typing import Literal, NamedTuple, get_args

import numpy as np

from binpick_env.config import CameraConfig

SizeClass = Literal["small", "medium", "large"]
ShapeClass = Literal["compact", "flat", "slender"]
# Upper limits of d_max in the image of small and medium parts [px]. They divide 20 to 200 mm, which the standard camera
# shows at 53 to 533 px, into three equal parts on a logarithmic scale.
SIZE_LIMITS_PX = (115.0, 248.0)
# Smallest ratio of two successive axes of a compact part: Zingg, "Beitrag zur Schotteranalyse", 1935.
AXIS_RATIO = 2 / 3


class PartClass(NamedTuple):
    """Class of a part: its size in the image, and its shape."""

    size: SizeClass
    shape: ShapeClass


CLASSES = tuple(PartClass(*both) for both in product(get_args(SizeClass), get_args(ShapeClass)))


def size_px(d_max: float, camera: CameraConfig) -> float:
    """Return the length in the image [px] of a part of ``d_max`` [m] that lies on the floor of the bin."""
    return d_max * camera.focal_px / camera.distance


def part_class(signature: Sequence[float], d_max_px: float) -> PartClass:
    """Return the class of a part.

    Its axes are the standard deviations of its volume along its principal axes. It is compact if each axis is at least
    2/3 of the next longer one. Otherwise the smaller of the two ratios decides: the part is flat if it is that of the
    shortest axis to the middle one, and slender if it is that of the middle axis to the longest. Zingg's fourth class,
    of parts that are both flat and slender, is divided between these two.

    Args:
        signature: Invariants of the part's shape, see :func:`perception.shape.shape_signature`.
        d_max_px: Largest extent of the part in the image [px].
    """
    size: SizeClass = get_args(SizeClass)[int(np.searchsorted(SIZE_LIMITS_PX, d_max_px))]
    squares = np.square(signature[-3:])  # radii of gyration about the axes; the smallest is that about the longest axis
    longest, middle, shortest = np.sqrt(np.maximum(squares.sum() / 2 - squares, 0.0))
    if min(middle / longest, shortest / middle) >= AXIS_RATIO:
        return PartClass(size, "compact")
    return PartClass(size, "flat" if shortest / middle < middle / longest else "slender")
