"""6D poses from boundary points alone: PPF-MEAM by edges, without a depth image.

Pairs of points vote for poses, which are refined on edges and ranked by how much of a group their edges explain.
Without depth nothing tells which edges are occluded, and whether a surface lies where the pose puts it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from perception.geometry import Floats, require_shape
from perception.instance import Instance
from perception.part import PartModel
from perception.pose.clustering import cluster_poses
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.hypotheses.voting import vote
from perception.pose.model.appearances import edge_appearances
from perception.pose.model.edge_models import edge_model
from perception.pose.model.pair_features import build_table
from perception.pose.model.thinning import thin_points
from perception.pose.verification._matching_kernels import explained_points
from perception.pose.verification.boundary_index import BoundaryIndex, index_boundary
from perception.pose.verification.refinement import refine_edges, view_direction
from perception.runtime.threads import in_threads
from perception.tangents import space_tangents

# What the depth image would tell besides; `EdgePose.unchecked` names it.
UNCHECKED = (
    "occlusion: edges that other parts hide count as missing",
    "surface: no depth shows that the part's faces lie where the pose puts them",
    "free space: the pose may lie where the camera saw through",
    "collisions: neither with other parts nor with the bin",
)


@dataclass(frozen=True, kw_only=True)
class EdgeEstimatorConfig:
    """Settings of an :class:`EdgePoseEstimator`."""

    search: EstimatorConfig = field(default_factory=EstimatorConfig)  # models, votes and refinement on edges
    finalists: int = 4  # number of hypotheses of a group that are refined with all edge points
    min_explained: float = 0.7  # least share of a group that a verified pose explains, in [0, 1]
    min_edges: float = 0.25  # least share of a part's edges that a verified pose finds in the cloud, in [0, 1]

    def __post_init__(self) -> None:
        if self.finalists < 1:
            raise ValueError(f"finalists must be at least 1, got {self.finalists}")
        for name in ("min_explained", "min_edges"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be in [0, 1], got {getattr(self, name)}")


@dataclass(frozen=True, eq=False, kw_only=True)
class EdgePose:
    """The pose of a part by its edges.

    Attributes:
        T_cam_part: (4, 4) pose of the part in the camera frame.
        instance_idx: Index of the group of boundary points that the pose was found in.
        explained: Share of the group's points that have an edge of the posed part of like tangent near them.
        edges: Share of the edges of the posed part, occluded ones included, with a boundary point of like tangent near.
        verified: Whether both shares reach the least ones. It says nothing about what is unchecked.
        unchecked: What could not be checked without a depth image.
    """

    T_cam_part: Floats
    instance_idx: int
    explained: float
    edges: float
    verified: bool
    unchecked: tuple[str, ...] = UNCHECKED

    @property
    def score(self) -> float:
        """Product of both shares, by which poses are ranked; no probability."""
        return self.explained * self.edges


class EdgePoseEstimator:
    """Estimates poses of one kind of part from groups of boundary points without a frame.

    Attributes:
        part: Part that is searched for.
        config: Settings.
    """

    def __init__(self, part: PartModel, config: EdgeEstimatorConfig | None = None) -> None:
        """Build the part's edge models, which takes some seconds the first time.

        Raises:
            ValueError: The part's mesh is empty, open or turned inside out.
        """
        self.part, self.config = part, config or EdgeEstimatorConfig()
        search = self.config.search
        self._table = build_table(edge_model(part, search.edges), search.pairs, part.symmetry)
        self._edges = edge_appearances(part, search.edges)
        self._coarse = self._edges.every(search.quick_step)

    def estimate(
        self, points_cam: Floats, instances: Sequence[Instance], tangents_cam: Floats | None = None
    ) -> list[EdgePose]:
        """Return the best pose of each group that has one, verified or not, best first.

        Args:
            points_cam: (N, 3) all boundary points in the camera frame, before the camera [m].
            instances: Groups of these points.
            tangents_cam: (N, 3) tangents of the points; from their neighbours in space unless given.

        Raises:
            ValueError: The shapes do not agree, or a point is not finite or not before the camera.
        """
        require_shape("points_cam", points_cam, (None, 3))
        if len(points_cam) == 0:
            return []
        if tangents_cam is None:
            tangents_cam, _ = space_tangents(points_cam, self.part.d_max)
        index = index_boundary(points_cam, tangents_cam, self.part.d_max)

        def search(k: int) -> EdgePose | None:
            chosen = instances[k].point_idx
            return self._best(points_cam[chosen], tangents_cam[chosen], index, k)

        found = [pose for pose in in_threads(search, range(len(instances))) if pose is not None]
        return sorted(found, key=lambda pose: (not pose.verified, -pose.score))

    def _best(self, points: Floats, tangents: Floats, index: BoundaryIndex, instance_idx: int) -> EdgePose | None:
        search = self.config.search
        spacing = search.edges.thinning * self.part.d_max
        kept = thin_points(points, tangents, spacing, search.edges.thinning_angle)
        points, tangents = points[kept], tangents[kept]
        raw = vote(self._table, points, tangents, config=search.votes)
        chosen, _ = cluster_poses(raw.T_cam_part, raw.votes, self.part, search.clusters)
        poses: list[EdgePose] = []
        for T_cam_part in raw.T_cam_part[chosen[: search.rough_hypotheses]]:
            rough = refine_edges(T_cam_part, self._coarse, index, search.rough_edges)
            coarse = refine_edges(rough.T_cam_part, self._coarse, index, search.quick_edges)
            poses.append(self._judged(coarse.T_cam_part, points, tangents, index, instance_idx))
        poses.sort(key=lambda pose: -pose.score)
        for coarse_pose in poses[: self.config.finalists]:
            fine = refine_edges(coarse_pose.T_cam_part, self._edges, index, search.edge_refinement)
            poses.append(self._judged(fine.T_cam_part, points, tangents, index, instance_idx))
        return max(poses, key=lambda pose: pose.score, default=None)

    def _judged(self, T: Floats, points: Floats, tangents: Floats, index: BoundaryIndex, instance_idx: int) -> EdgePose:
        limits = self.config.search.verification
        seen = self._edges.seen_from(view_direction(T, self._edges.centre))
        gate, max_angle = limits.edge_distance * self.part.d_max, limits.edge_angle
        matched = index.match(T, *seen, gate=gate, max_angle=max_angle) >= 0
        explained = explained_points(T, *seen, points, tangents, gate, gate, float(np.cos(max_angle)))
        shares = [float(np.mean(mask)) if len(mask) else 0.0 for mask in (explained, matched)]
        verified = shares[0] >= self.config.min_explained and shares[1] >= self.config.min_edges
        return EdgePose(
            T_cam_part=T, instance_idx=instance_idx, explained=shares[0], edges=shares[1], verified=verified
        )
