"""Distance of two points in the embedding, as the paper prints it or as SGPN's released code computes it."""

from typing import Literal

import numpy as np

Distance = Literal["l2", "scaled_square"]  # ||df||_2 as printed, or 10 ||df||^2 as in SGPN's released code
SQUARE_SCALE = 10.0  # factor of ``scaled_square``


def squared_threshold(threshold: float, distance: Distance) -> float:
    """Return the squared Euclidean embedding distance that ``threshold`` stands for.

    Raises:
        ValueError: The threshold is not positive and finite, or there is no such distance.
    """
    if not 0 < threshold < np.inf:
        raise ValueError(f"threshold must be positive and finite, got {threshold}")
    if distance == "l2":
        return threshold**2
    if distance == "scaled_square":
        return threshold / SQUARE_SCALE
    raise ValueError(f"distance must be 'l2' or 'scaled_square', got {distance!r}")
