"""Inputs of the networks over point sets."""

import numpy as np
from numpy.typing import NDArray

Singles = NDArray[np.float32]


def centred(points: NDArray[np.floating], unit: float) -> Singles:
    """Return (N, 3) points relative to the centre of their bounding box, in multiples of ``unit`` [m]."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return np.asarray((points - middle) / unit, np.float32)
