"""Score drop under perturbation: how much worse a pose fits when the part is rotated a little.

Where everything that fixes a rotation is occluded, rotated poses fit as well as the right one, and no rival hypothesis
needs to show it. For example, a tee whose branch is behind another part may have any rotation about its run.
"""

from collections.abc import Callable

import numpy as np

from perception.geometry import Floats, make_transform, rotation_about
from perception.part import PartModel

ANGLE = float(np.deg2rad(8.0))  # of each perturbation; more than a right pose is off [rad]
_SAME = float(np.deg2rad(2.0))  # a rotation that the symmetry reduces to less than this is left out [rad]


def small_rotations(part: PartModel) -> Floats:
    """Return (K, 4, 4) motions that rotate a part by `ANGLE` about its centre, expressed in the part frame.

    They rotate both ways about each principal axis. Rotations that the part's symmetry undoes are left out.
    """
    axes = np.asarray(part.mesh.principal_inertia_vectors, np.float64)
    motions = []
    for axis in np.concatenate([axes, -axes]):
        rotation = rotation_about(axis, ANGLE)
        if part.symmetry.distance(rotation, np.eye(3)) > _SAME:
            motions.append(make_transform(rotation, part.centre - rotation @ part.centre))
    return np.array(motions).reshape(-1, 4, 4)


def score_drop(T_cam_part: Floats, perturbations: Floats, logit: Callable[[Floats], float]) -> float:
    """Return the smallest decrease of a pose's logit over all perturbations; infinite if there are none.

    Args:
        T_cam_part: (4, 4) pose of the part in the camera frame.
        perturbations: (K, 4, 4) motions in the part frame.
        logit: Function that returns the logit of a (4, 4) pose.
    """
    here = logit(T_cam_part)
    return min((here - logit(T_cam_part @ motion) for motion in perturbations), default=np.inf)
