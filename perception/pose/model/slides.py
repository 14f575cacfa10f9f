"""Slides: motions of a long part along its axis, after which its middle looks the same and only its ends tell.

A rod whose ends are occluded may lie anywhere along its axis. Voting finds one such pose, and without the others
nothing shows that it is one of many. So the slides of a good hypothesis are always tried, too.
"""

import numpy as np

from perception.geometry import Floats, make_transform
from perception.part import PartModel

SLENDER = 4.0  # ratio of the length of a part to its second largest extent from which it can slide
STEPS = (0.11, 0.22, 0.33)  # lengths of the slides as shares of d_max; poses closer than 0.1 d_max count as alike


def slides(part: PartModel) -> Floats:
    """Return (K, 4, 4) motions in the part frame along a long part's axis, both ways; none for other parts.

    Args:
        part: Part whose extents along its principal axes of inertia decide.
    """
    axes = np.asarray(part.mesh.principal_inertia_vectors, np.float64)
    extents = np.ptp(np.asarray(part.mesh.vertices, np.float64) @ axes.T, axis=0)
    longest = int(np.argmax(extents))
    if extents[longest] < SLENDER * np.delete(extents, longest).max():
        return np.zeros((0, 4, 4))
    motions = [make_transform(translation=s * step * part.d_max * axes[longest]) for step in STEPS for s in (1.0, -1.0)]
    return np.array(motions)
