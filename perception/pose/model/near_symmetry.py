"""Turns after which a part looks nearly the same: the poses that are mistaken for each other.

A bracket whose legs differ by little, a pipe tee whose branch is hidden: voting may find one of two such poses and not
the other, and then nothing tells how little separates them. So the twins of a good pose are always looked at, too.
"""

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from scipy.spatial import cKDTree

from perception.geometry import Floats, make_transform, rotation_about
from perception.part import PartModel
from perception.pose.clustering import ClusterConfig, cluster_poses
from perception.pose.model.surface_model import SurfaceModel
from perception.runtime.cache import Arrays, cached_arrays, digest

_VERSION = 1  # of what is stored: raise it whenever the same part and settings give other twins
_STEPS = 20  # of the registration of a turned part with itself


@dataclass(frozen=True, kw_only=True)
class TwinConfig:
    """Which twins are looked at.

    Attributes:
        most: So many, the most alike first.
        distance: Mean distance between the surfaces of twins, at most, as a share of d_max.
        lead: A twin whose evidence is this much lower, before it is refined, is none.
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


def part_twins(part: PartModel, surface: SurfaceModel, config: TwinConfig | None = None) -> Floats:
    """Return (K, 4, 4) motions of a part, in its own frame, that bring it nearly onto itself; none is a symmetry.

    The turns that map the part's principal axes onto each other are tried, each registered with the part.

    Args:
        part: The part.
        surface: The same part's.
        config: :class:`TwinConfig`'s defaults if left out.

    Note:
        Deterministic. Kept in the cache folder; the first call takes some tenths of a second.
    """
    config = config or TwinConfig()
    key = digest(_VERSION, surface.points, part.symmetry.rotations, part.symmetry.axis, config.most, config.distance)
    return cached_arrays("twins", key, lambda: _compute(part, surface, config))["motions"]


def _compute(part: PartModel, surface: SurfaceModel, config: TwinConfig) -> Arrays:
    axes = np.asarray(part.mesh.principal_inertia_vectors, np.float64).T
    tree = cKDTree(surface.points)
    motions, distances = [], []
    for turn in _cube_turns():
        rotation = axes @ turn @ axes.T
        T = make_transform(rotation, part.centre - rotation @ part.centre)
        T, distance = _registered(T, surface, tree)
        motions.append(T)
        distances.append(distance)
    poses = np.array([np.eye(4), *motions])
    # The best of those that differ from each other and from the part as it is: that one comes first.
    scores = np.append(1.0, np.exp(-np.array(distances) / part.d_max) / 2)
    heads, _ = cluster_poses(poses, scores, part, ClusterConfig(translation=0.5))
    near = [k for k in heads if k > 0 and distances[k - 1] <= config.distance * part.d_max]
    near.sort(key=lambda k: distances[k - 1])
    return {"motions": poses[near[: config.most]].reshape(-1, 4, 4)}


def _cube_turns() -> list[Floats]:
    """Return the 24 turns of a cube, but for the identity."""
    turns = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        turn = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if np.linalg.det(turn) > 0 and not np.array_equal(turn, np.eye(3)):
            turns.append(turn)
    return turns


def _registered(T: Floats, surface: SurfaceModel, tree: cKDTree) -> tuple[Floats, float]:
    """Move a turned part onto itself, point to plane, and return the motion and the mean distance left [m]."""
    for _ in range(_STEPS):
        points = surface.points @ T[:3, :3].T + T[:3, 3]
        _, nearest = tree.query(points)
        normals = surface.normals[nearest]
        gaps = np.einsum("ni,ni->n", surface.points[nearest] - points, normals)
        arms = points - surface.centre
        jacobian = np.hstack([np.cross(arms, normals), normals])
        # Freedoms that nothing tells, along a plane or about an axis, are damped to zero.
        scale = np.array([surface.d_max] * 3 + [1.0] * 3)
        scaled = jacobian / scale
        step = np.linalg.solve(scaled.T @ scaled + 1e-3 * len(points) * np.eye(6), scaled.T @ gaps) / scale
        angle = float(np.linalg.norm(step[:3]))
        rotation = rotation_about(step[:3], angle) if angle > 0 else np.eye(3)
        T = make_transform(rotation, surface.centre - rotation @ surface.centre + step[3:]) @ T
    points = surface.points @ T[:3, :3].T + T[:3, 3]
    there, _ = tree.query(points)
    back, _ = cKDTree(points).query(surface.points)
    return T, float(np.mean(there) + np.mean(back)) / 2
