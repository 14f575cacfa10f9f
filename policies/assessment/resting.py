"""How a part rests on a floor: its stable poses, those that symmetry makes equal as one, with their shares of drops."""

from dataclasses import dataclass

import numpy as np
import trimesh

from perception.geometry import Floats, make_transform
from perception.part import PartModel, Symmetry

SAME = float(np.cos(np.deg2rad(5.0)))  # cosine of the largest angle between the up directions of one resting pose
_LEAST = 0.01  # smallest share of drops of a resting pose that is named


@dataclass(frozen=True, kw_only=True)
class RestingPose:
    """A stable pose of a part alone on a floor.

    Attributes:
        share: Share of the drops that end in this pose, in [0, 1]; quasi-static, see :func:`resting_poses`.
        up: Direction that points upwards, part axes.
        height: Height of the part's highest point over the floor [m].
    """

    share: float
    up: tuple[float, float, float]
    height: float

    def T_floor_part(self, model: PartModel) -> Floats:
        """Return the (4, 4) pose of the part at rest on the plane z = 0, its centre over the origin."""
        up = np.array(self.up)
        across = np.linalg.svd(up[None])[2][1]
        R = np.stack([across, np.cross(up, across), up])
        turned = (np.asarray(model.mesh.vertices) - model.centre) @ R.T
        return make_transform(R, np.array([0.0, 0.0, -turned[:, 2].min()]) - R @ model.centre)


def resting_poses(model: PartModel) -> tuple[RestingPose, ...]:
    """Return the stable poses of a part, the most frequent first.

    Shares are those of a part dropped without spin that rolls over the edges of its hull until it is stable, as
    Goldberg et al. compute them ("Part pose statistics", IEEE Transactions on Robotics and Automation 1999; trimesh's
    ``compute_stable_poses``). Poses that turn into each other by a symmetry are one; those under 1 % are left out.

    Args:
        model: Any watertight part.

    Note:
        Deterministic; some tenths of a second for a hull of a thousand faces.
    """
    if model.symmetry.sphere:
        return (RestingPose(share=1.0, up=(0.0, 0.0, 1.0), height=model.d_max),)
    transforms, shares = trimesh.poses.compute_stable_poses(model.mesh, sigma=0.0, n_samples=1, threshold=0.0)
    ups: list[Floats] = []
    totals: list[float] = []
    for T, share in zip(transforms, shares, strict=True):
        up = T[2, :3]
        same = [k for k, known in enumerate(ups) if _equal(up, known, model.symmetry)]
        if same:
            totals[same[0]] += float(share)
        else:
            ups.append(up)
            totals.append(float(share))
    whole = sum(totals)
    found = [(total / whole, up) for total, up in zip(totals, ups, strict=True) if total >= _LEAST * whole]
    found.sort(key=lambda each: -each[0])
    return tuple(_resting(share, up, model) for share, up in found)


def _equal(a: Floats, b: Floats, symmetry: Symmetry) -> bool:
    """Tell whether a rotation of the symmetry group turns one direction into another, to 5 deg."""
    images = a @ np.swapaxes(symmetry.rotations, -1, -2)
    if symmetry.axis is None:
        return bool((images @ b).max() > SAME)
    angles = np.arccos(np.clip(images @ symmetry.axis, -1.0, 1.0)) - np.arccos(np.clip(b @ symmetry.axis, -1.0, 1.0))
    return bool(np.abs(angles).min() < np.arccos(SAME))


def _resting(share: float, up: Floats, model: PartModel) -> RestingPose:
    x, y, z = (float(value) for value in up)
    return RestingPose(share=share, up=(x, y, z), height=float(np.ptp(np.asarray(model.mesh.vertices) @ up)))
