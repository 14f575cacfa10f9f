"""Grey values of coloured points."""

import cv2
import numpy as np
from numpy.typing import NDArray


def grey_of_channels(
    red: NDArray[np.generic], green: NDArray[np.generic], blue: NDArray[np.generic]
) -> NDArray[np.uint8]:
    """Return the (N,) uint8 grey values of (N,) uint8 channels, weighted by OpenCV."""
    pixels = np.stack([red, green, blue], axis=-1).astype(np.uint8)
    return np.asarray(cv2.cvtColor(pixels[None], cv2.COLOR_RGB2GRAY)[0], np.uint8)


def grey_of_packed(colours: NDArray[np.uint32]) -> NDArray[np.uint8]:
    """Return the (N,) uint8 grey values of (N,) colours packed as 0xAARRGGBB, the layout of PCL.

    PCL stores these bits in a float as well, which may then be NaN; they are colours all the same.
    """
    return grey_of_channels((colours >> 16) & 255, (colours >> 8) & 255, colours & 255)
