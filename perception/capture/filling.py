"""Holes of images, filled."""

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

Pixel = TypeVar("Pixel", np.float32, np.uint8)


def fill_from_nearest(image: NDArray[Pixel], valid: NDArray[np.bool_]) -> NDArray[Pixel]:
    """Return an (H, W) image whose pixels outside the mask have the value of the nearest pixel inside, which exists."""
    if valid.all():
        return image
    labels = cv2.distanceTransformWithLabels((~valid).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)[
        1
    ]
    value_of = np.zeros(int(labels.max()) + 1, image.dtype)
    value_of[labels[valid]] = image[valid]
    filled: NDArray[Pixel] = value_of[labels]
    return filled
