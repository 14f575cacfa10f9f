"""Bregier's distance between poses: how far a part's surface moves from one to the other, modulo symmetry.

Source: Bregier et al., "Defining the Pose of any 3D Rigid Object and an Associated Distance", IJCV 2018, and "Symmetry
aware evaluation of 3D object detection and pose estimation in scenes of many parts in bulk", ICCVW 2017. Poses are
(4, 4) float64 ``T_cam_part``. S representatives of a pose, D their dimension.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial.distance import cdist

from perception.geometry import Floats, require_shape
from perception.part import PartModel


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseSpace:
    """Poses of one part as points of a Euclidean space.

    A pose has S representatives (vec(R B_s), R c + t), and the distance of two poses is the least between one's first
    and the other's: the root mean square, over the surface, of the distance between a point in the two poses, least
    over the symmetries. It is a metric, exact also for solids of revolution.

    Attributes:
        centroid: (3,) c, of the surface, part frame [m].
        bases: (S, 3, M) B_s [m]: ``G_s L`` for a finite group, L being the square root of the surface's covariance
            (M = 3, D = 12), and ``l G_s a`` for a solid of revolution about a, whose l squared is the sum of the
            covariance's parts along and across the axis (M = 1, D = 6).
    """

    centroid: Floats
    bases: Floats

    def __post_init__(self) -> None:
        require_shape("centroid", self.centroid, (3,))
        require_shape("bases", self.bases, (None, 3, None))
        if len(self.bases) == 0:
            raise ValueError("bases must hold at least one representative, got none")

    @classmethod
    def of(cls, part: PartModel) -> "PoseSpace":
        """Measure the surface of ``part``.

        The moments are averaged over the declared group, which changes nothing where the mesh has the symmetry
        exactly, and lets the distance have it also where a mesh of facets has it nearly.
        """
        centroid, covariance = surface_moments(part.mesh)
        group, axis = part.symmetry.rotations, part.symmetry.axis
        offset = centroid - part.centre
        if axis is None:
            covariance = (group @ covariance @ np.swapaxes(group, -1, -2)).mean(axis=0)
            bases = group @ _square_root(covariance)
        else:
            along = float(axis @ covariance @ axis)
            across = (float(np.trace(covariance)) - along) / 2
            offset = (offset @ axis) * axis
            bases = np.sqrt(along + across) * _different(group @ axis)[:, :, None]
        return cls(centroid=part.centre + (group @ offset).mean(axis=0), bases=bases)

    def representatives(self, T: Floats) -> Floats:
        """Return the (..., S, D) representatives [m] of (..., 4, 4) poses.

        The nearest neighbour of the first one of a pose among all of many poses finds the nearest pose.
        """
        if T.ndim < 2 or T.shape[-2:] != (4, 4):
            raise ValueError(f"poses must be (..., 4, 4), got {T.shape}")
        turned = T[..., None, :3, :3] @ self.bases
        spread = turned.reshape(*turned.shape[:-2], -1)
        position = (T[..., :3, :3] @ self.centroid + T[..., :3, 3])[..., None, :]
        return np.concatenate([spread, np.broadcast_to(position, (*spread.shape[:-1], 3))], axis=-1)

    def distance(self, T_a: Floats, T_b: Floats) -> float:
        """Return the distance [m] between two (4, 4) poses."""
        return float(self.distances(T_a[None], T_b[None])[0, 0])

    def distances(self, T_a: Floats, T_b: Floats) -> Floats:
        """Return the (A, B) distances [m] between (A, 4, 4) and (B, 4, 4) poses."""
        require_shape("T_a", T_a, (None, 4, 4))
        require_shape("T_b", T_b, (None, 4, 4))
        first, every = self.representatives(T_a)[:, 0], self.representatives(T_b)
        apart = cdist(first, every.reshape(-1, first.shape[1]))
        least: Floats = apart.reshape(len(T_a), len(T_b), len(self.bases)).min(axis=-1)
        return least


def surface_moments(mesh: trimesh.Trimesh) -> tuple[Floats, Floats]:
    """Return the centroid (3,) [m] and covariance (3, 3) [m^2] of a mesh's surface, exactly.

    The integral of x x' over a triangle of area A and corners a, b, c is A / 12 (s s' + a a' + b b' + c c'), s being
    a + b + c.
    """
    triangles = np.asarray(mesh.triangles, np.float64)
    middle = triangles.mean(axis=(0, 1))  # moments about a point nearby: no digits are lost far from the origin
    corners = triangles - middle
    edges = corners[:, 1:] - corners[:, :1]
    areas = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    total = areas.sum()
    if not total > 0:
        raise ValueError(f"the mesh must have a surface, got {len(areas)} triangles of area {total}")
    sums = corners.sum(axis=1)
    centroid = areas @ sums / (3 * total)
    second = np.einsum("t,ti,tj->ij", areas, sums, sums) + np.einsum("t,tki,tkj->ij", areas, corners, corners)
    return middle + centroid, second / (12 * total) - np.outer(centroid, centroid)


def _different(images: Floats) -> Floats:
    """Return the different ones of (N, 3) images of an axis: itself, and its opposite if the ends are alike."""
    new = [k for k in range(len(images)) if not any(np.allclose(images[k], images[j], atol=1e-6) for j in range(k))]
    kept: Floats = images[new]
    return kept


def _square_root(covariance: Floats) -> Floats:
    """Return the symmetric square root of a (3, 3) positive semidefinite matrix."""
    values, vectors = np.linalg.eigh(covariance)
    root: Floats = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return root
