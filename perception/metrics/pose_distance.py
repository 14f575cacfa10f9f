"""Bregier's distance between poses: the displacement of a part's surface, modulo symmetry.

Source: Bregier et al., "Defining the Pose of any 3D Rigid Object and an Associated Distance", IJCV 2018, and "Symmetry
aware evaluation of 3D object detection and pose estimation in scenes of many parts in bulk", ICCVW 2017. Poses are
(4, 4) float64 ``T_cam_part``. S is the number of representatives of a pose, D their dimension.
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

    A pose has S representatives (vec(R B_s), R c + t). The distance of two poses is the least one between the first
    representative of one pose and the representatives of the other. It equals the root mean square of the distances
    between corresponding surface points, minimised over the symmetries. It is a metric, exact also for solids of
    revolution.

    Attributes:
        centroid: (3,) centroid c of the surface in the part frame [m].
        bases: (S, 3, M) bases B_s [m]. For a finite group, ``B_s = G_s L`` with the square root L of the covariance of
            the surface (M = 3, D = 12). For a solid of revolution about a, ``B_s = l G_s a``, where l squared is the
            sum of the covariance along and across the axis (M = 1, D = 6). For a ball, whose poses differ by position
            only, ``B_s = 0`` (M = 1, D = 6).
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
        """Return the pose space of a part.

        The moments of the surface are averaged over the declared symmetry group. This changes nothing if the mesh has
        the symmetry exactly. For a faceted mesh, it gives the distance the exact symmetry.
        """
        centroid, covariance = surface_moments(part.mesh)
        group, axis = part.symmetry.rotations, part.symmetry.axis
        offset = centroid - part.centre
        if part.symmetry.sphere:
            return cls(centroid=np.array(part.centre), bases=np.zeros((1, 3, 1)))
        if axis is None:
            covariance = (group @ covariance @ np.swapaxes(group, -1, -2)).mean(axis=0)
            bases = group @ _square_root(covariance)
        else:
            along = float(axis @ covariance @ axis)
            across = (float(np.trace(covariance)) - along) / 2
            offset = (offset @ axis) * axis
            bases = np.sqrt(along + across) * _distinct(group @ axis)[:, :, None]
        return cls(centroid=part.centre + (group @ offset).mean(axis=0), bases=bases)

    def representatives(self, T: Floats) -> Floats:
        """Return the (..., S, D) representatives [m] of (..., 4, 4) poses.

        The nearest neighbour of a pose's first representative among the representatives of other poses belongs to the
        nearest of these poses.
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

    The integral of x x' over a triangle of area A and corners a, b, c is A / 12 (s s' + a a' + b b' + c c') with
    s = a + b + c.
    """
    triangles = np.asarray(mesh.triangles, np.float64)
    middle = triangles.mean(axis=(0, 1))  # moments about a nearby point, which keeps precision far from the origin
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


def _distinct(images: Floats) -> Floats:
    """Return the distinct ones of (N, 3) images of an axis: the axis, and its opposite if the ends are alike."""
    new = [k for k in range(len(images)) if not any(np.allclose(images[k], images[j], atol=1e-6) for j in range(k))]
    kept: Floats = images[new]
    return kept


def _square_root(covariance: Floats) -> Floats:
    """Return the symmetric square root of a (3, 3) positive semidefinite matrix."""
    values, vectors = np.linalg.eigh(covariance)
    root: Floats = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return root
