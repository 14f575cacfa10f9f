"""How firmly a pose is held: what becomes of its evidence when the part is turned a little.

Where all that tells a turn is hidden, turned poses fit as well as the right one, and none of the rivals found need show
it: a pipe's branch behind another part leaves the turn about the pipe open.
"""

from collections.abc import Callable

import numpy as np

from perception.geometry import Floats, make_transform, rotation_about
from perception.part import PartModel

TURN = float(np.deg2rad(8.0))  # more than a right pose may be off [rad]
_SAME = float(np.deg2rad(2.0))  # a turn that the part's symmetry makes less than this is none [rad]


def small_rotations(part: PartModel) -> Floats:
    """Return (K, 4, 4) turns by `TURN`, both ways about each principal axis, that a part's symmetry does not undo.

    They are motions in the part's own frame, and keep its centre.
    """
    axes = np.asarray(part.mesh.principal_inertia_vectors, np.float64)
    turns = []
    for axis in np.concatenate([axes, -axes]):
        rotation = rotation_about(axis, TURN)
        if part.symmetry.distance(rotation, np.eye(3)) > _SAME:
            turns.append(make_transform(rotation, part.centre - rotation @ part.centre))
    return np.array(turns).reshape(-1, 4, 4)


def firmness(T_cam_part: Floats, turns: Floats, evidence: Callable[[Floats], float]) -> float:
    """Return by how much the evidence falls at least, whichever way the part turns; infinite if there is no turn.

    Args:
        T_cam_part: (4, 4).
        turns: (K, 4, 4) in the part's own frame.
        evidence: What speaks for a (4, 4) pose.
    """
    here = evidence(T_cam_part)
    return min((here - evidence(T_cam_part @ turn) for turn in turns), default=np.inf)
