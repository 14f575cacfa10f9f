"""Near-symmetries: motions after which a part looks nearly the same, so that its poses are mistaken for each other.

Examples are a bracket whose legs differ by little, and a tee whose branch is occluded. Voting may find one of two such
poses and not the other, and then nothing shows how little they differ. So the near-symmetric poses of a good hypothesis
are always tried, too.
"""

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from scipy.spatial import cKDTree

from perception.geometry import Floats, make_transform, rotation_about
from perception.part import PartModel
from perception.pose.clustering import ClusterConfig, cluster_poses
from perception.pose.model.surface_models import SurfaceModel
from perception.runtime.cache import Arrays, cached_arrays, digest

_VERSION = 1  # of what is stored: raise it whenever the same part and settings give other motions
_STEPS = 20  # iterations of the registration of a rotated part with itself


@dataclass(frozen=True, kw_only=True)
class NearSymmetryConfig:
    """Which near-symmetries of a part are used.

    Attributes:
        most: Largest number of near-symmetries, the closest ones first.
        distance: Largest mean distance between the surfaces of the part before and after the motion, as a share of
            d_max.
        lead: Largest lead of a hypothesis over a near-symmetric pose in the logit, before refinement, with which that
            pose is still refined.
    """

    most: int = 3
    distance: float = 0.05
    lead: float = 6.0

    def __post_init__(self) -> None:
        if self.most < 0:
            raise ValueError(f"most must not be negative, got {self.most}")
        for name in ("distance", "lead"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")


def near_symmetries(part: PartModel, surface: SurfaceModel, config: NearSymmetryConfig | None = None) -> Floats:
    """Return (K, 4, 4) motions in the part frame that bring a part nearly onto itself, without its symmetries.

    The rotations that map the part's principal axes onto each other are tried. Each is registered with the part.

    Args:
        part: Part whose near-symmetries are searched for.
        surface: Samples of the same part's surface.
        config: Limits; the defaults of :class:`NearSymmetryConfig` if None.

    Note:
        Deterministic. The result is kept in the cache folder; the first call takes some tenths of a second.
    """
    config = config or NearSymmetryConfig()
    if part.symmetry.sphere:
        return np.zeros((0, 4, 4))
    key = digest(_VERSION, surface.points, part.symmetry.rotations, part.symmetry.axis, config.most, config.distance)
    return cached_arrays("near_symmetry", key, lambda: _compute(part, surface, config))["motions"]


def _compute(part: PartModel, surface: SurfaceModel, config: NearSymmetryConfig) -> Arrays:
    axes = np.asarray(part.mesh.principal_inertia_vectors, np.float64).T
    tree = cKDTree(surface.points)
    motions, distances = [], []
    for permutation in _cube_rotations():
        rotation = axes @ permutation @ axes.T
        T = make_transform(rotation, part.centre - rotation @ part.centre)
        T, distance = _registered(T, surface, tree)
        motions.append(T)
        distances.append(distance)
    poses = np.array([np.eye(4), *motions])
    # Representatives differ from each other and from the identity, which has the highest score.
    scores = np.append(1.0, np.exp(-np.array(distances) / part.d_max) / 2)
    representatives, _ = cluster_poses(poses, scores, part, ClusterConfig(translation=0.5))
    near = [k for k in representatives if k > 0 and distances[k - 1] <= config.distance * part.d_max]
    near.sort(key=lambda k: distances[k - 1])
    return {"motions": poses[near[: config.most]].reshape(-1, 4, 4)}


def _cube_rotations() -> list[Floats]:
    """Return the 24 (3, 3) rotations of a cube without the identity."""
    rotations = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        rotation = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if np.linalg.det(rotation) > 0 and not np.array_equal(rotation, np.eye(3)):
            rotations.append(rotation)
    return rotations


def _registered(T: Floats, surface: SurfaceModel, tree: cKDTree) -> tuple[Floats, float]:
    """Return a (4, 4) motion registered by point-to-plane ICP, and the mean distance that remains [m]."""
    for _ in range(_STEPS):
        points = surface.points @ T[:3, :3].T + T[:3, 3]
        _, nearest = tree.query(points)
        normals = surface.normals[nearest]
        gaps = np.einsum("ni,ni->n", surface.points[nearest] - points, normals)
        arms = points - surface.centre
        jacobian = np.hstack([np.cross(arms, normals), normals])
        # Unobservable degrees of freedom, along a plane or about an axis, are damped to zero.
        scale = np.array([surface.d_max] * 3 + [1.0] * 3)
        scaled = jacobian / scale
        step = np.linalg.solve(scaled.T @ scaled + 1e-3 * len(points) * np.eye(6), scaled.T @ gaps) / scale
        angle = float(np.linalg.norm(step[:3]))
        rotation = rotation_about(step[:3], angle) if angle > 0 else np.eye(3)
        T = make_transform(rotation, surface.centre - rotation @ surface.centre + step[3:]) @ T
    points = surface.points @ T[:3, :3].T + T[:3, 3]
    forth, _ = tree.query(points)
    back, _ = cKDTree(points).query(surface.points)
    return T, float(np.mean(forth) + np.mean(back)) / 2
