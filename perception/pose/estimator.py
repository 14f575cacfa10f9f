"""PPF-MEAM behind one door: boundary points of a group in, the 6-D pose of the part they belong to out.

Reconstructed from the abstract of Liu et al., "PPF-MEAM", Sensors 18 (2018): votes of point pairs give raw poses, which
are clustered modulo symmetry, scored, refined and verified.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from perception.boundary import BoundaryCloud
from perception.frame import Frame
from perception.geometry import Floats, require_shape
from perception.part import PartModel
from perception.pose._verification_kernels import near_points
from perception.pose.appearances import edge_appearances
from perception.pose.boundary_index import BoundaryIndex, index_boundary
from perception.pose.clustering import ClusterConfig, are_alike, cluster_poses
from perception.pose.confidence import ConfidenceConfig, confidence
from perception.pose.edge_models import EdgeModelConfig, edge_model
from perception.pose.pair_features import PairConfig, build_table
from perception.pose.refinement import EdgeRefinement, SurfaceRefinement, refine_edges, refine_surface
from perception.pose.surface_model import surface_model
from perception.pose.thinning import thin_points
from perception.pose.verification import Verdict, VerificationConfig, verify
from perception.pose.voting import RawPoses, VoteConfig, vote
from perception.segmentation.instance import Instance

RIVALS = 0.25  # of d_max: poses of a scene whose centres are nearer speak of the same points
Looked = tuple[Floats, Verdict]  # (4, 4) T_cam_part and what speaks for it
Group = tuple[Floats, Floats]  # (N, 3) boundary points, camera frame [m], and their (N, 3) tangents


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseEstimate:
    """Where a part is.

    Attributes:
        T_cam_part: (4, 4).
        score: Chance that the pose is right, in [0, 1].
        instance_idx: Index of the group it was found by; -1 without groups.
        visible_fraction: Estimated share of the part's camera-facing surface that is seen.
        verdict: What speaks for it and against it.
        margin: By how much its evidence exceeds that of the best pose of the group that differs from it.
        size: Boundary points that it was found by, thinned.
    """

    T_cam_part: Floats
    score: float
    instance_idx: int
    visible_fraction: float
    verdict: Verdict
    margin: float
    size: int

    def __post_init__(self) -> None:
        require_shape("T_cam_part", self.T_cam_part, (4, 4))
        if not 0 <= self.score <= 1:
            raise ValueError(f"score must be in [0, 1], got {self.score}")


@dataclass(frozen=True, kw_only=True)
class EstimatorConfig:
    """How poses are found.

    Attributes:
        edges: What an edge is, and from how many views pairs are taken.
        pairs: Features and table.
        votes: Accumulator.
        clusters: When two poses are one.
        quick_edges: Refinement of every hypothesis, on edges ...
        quick_surface: ... and on the surface.
        edge_refinement: Of those that are left.
        surface_refinement: Of those that are left.
        verification: Tolerances, and the evidence that hypotheses are ranked by.
        confidence: How sure the best one is.
        hypotheses: Clusters of raw poses that are looked at for each group, those with most votes first ...
        most_hypotheses: ... and up to this many while none has the score ``sure``.
        sure: See ``most_hypotheses``.
        finalists: Of these, best scores first, that are refined to the end.
        scene_hypotheses: Clusters that are looked at where a whole scene is searched.
        min_score: A pose with this score is verified.
    """

    edges: EdgeModelConfig = field(default_factory=EdgeModelConfig)
    pairs: PairConfig = field(default_factory=PairConfig)
    votes: VoteConfig = field(default_factory=VoteConfig)
    clusters: ClusterConfig = field(default_factory=ClusterConfig)
    quick_edges: EdgeRefinement = field(default_factory=lambda: EdgeRefinement(gates=(0.05, 0.03), iterations=4))
    quick_surface: SurfaceRefinement = field(default_factory=SurfaceRefinement)
    edge_refinement: EdgeRefinement = field(default_factory=EdgeRefinement)
    surface_refinement: SurfaceRefinement = field(default_factory=SurfaceRefinement)
    verification: VerificationConfig = field(default_factory=VerificationConfig)
    confidence: ConfidenceConfig = field(default_factory=ConfidenceConfig)
    hypotheses: int = 4
    most_hypotheses: int = 12
    sure: float = 0.9
    finalists: int = 2
    scene_hypotheses: int = 100
    min_score: float = 0.87

    def __post_init__(self) -> None:
        for name in ("hypotheses", "most_hypotheses", "finalists", "scene_hypotheses"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.most_hypotheses < self.hypotheses:
            raise ValueError(f"most_hypotheses must be at least {self.hypotheses}, got {self.most_hypotheses}")
        for name in ("min_score", "sure"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be in [0, 1], got {getattr(self, name)}")


@dataclass(frozen=True, eq=False, kw_only=True)
class _Scene:
    """What every group of a frame is compared with."""

    frame: Frame
    boundary: BoundaryIndex


class PoseEstimator:
    """Finds the poses of one kind of part."""

    def __init__(self, part: PartModel, config: EstimatorConfig | None = None) -> None:
        """Build the part's models; the first time this takes some seconds, later ones read the cache.

        Raises:
            ValueError: The part's mesh is empty, open or turned inside out.
        """
        self.part = part
        self.config = config or EstimatorConfig()
        edges = edge_model(part, self.config.edges)
        self.table = build_table(
            edges.points,
            edges.tangents,
            edges.visibility,
            part.d_max,
            self.config.pairs,
            symmetry=part.symmetry,
            centre=part.centre,
        )
        self.appearances = edge_appearances(part, self.config.edges)
        self.surface = surface_model(part)

    def estimate(self, boundary: BoundaryCloud, instances: Sequence[Instance], frame: Frame) -> list[PoseEstimate]:
        """Return the verified poses of the groups, best first, each part once; none for an empty scene.

        Args:
            boundary: All boundary points of the frame.
            instances: Groups of them.
            frame: The same frame.

        Raises:
            ValueError: There are groups, but the frame has no depth.
        """
        return self.verified(self.estimate_groups(boundary, instances, frame))

    def estimate_groups(
        self, boundary: BoundaryCloud, instances: Sequence[Instance], frame: Frame
    ) -> list[PoseEstimate | None]:
        """Return the best pose of each group, verified or not; None where pairs vote for none."""
        if len(boundary) == 0:
            return [None for _ in instances]
        scene = self._scene(boundary, frame)
        found: list[PoseEstimate | None] = []
        for k, instance in enumerate(instances):
            group = self._thinned(boundary.points_cam[instance.point_idx], boundary.tangents_cam[instance.point_idx])
            found.append(self._best(self._heads(vote(self.table, *group, config=self.config.votes)), group, scene, k))
        return found

    def estimate_scene(self, boundary: BoundaryCloud, frame: Frame) -> list[PoseEstimate]:
        """Return the verified poses of a whole scene without groups: PPF-MEAM alone, as before segmentation."""
        if len(boundary) == 0:
            return []
        scene, config = self._scene(boundary, frame), self.config
        cloud = self._thinned(boundary.points_cam, boundary.tangents_cam)
        raw = vote(self.table, *cloud, config=config.votes)
        looked, sizes = [], []
        for T in self._heads(raw, config.scene_hypotheses):
            near = near_points(
                T, self.surface.points, self.surface.visible(T), cloud[0], 2 * config.edges.thinning * self.part.d_max
            )
            looked.append(self._refined(T, (cloud[0][near], cloud[1][near]), scene, final=True))
            sizes.append(len(near))
        centres = np.array([T[:3, :3] @ self.part.centre + T[:3, 3] for T, _ in looked]).reshape(-1, 3)
        found = []
        for k, size in enumerate(sizes):
            # Two parts cannot lie this deep in each other: poses that do are rivals.
            within = np.linalg.norm(centres - centres[k], axis=1) <= RIVALS * self.part.d_max
            rivals = [looked[j] for j in np.flatnonzero(within) if j != k]
            found.append(self._estimate(looked[k], rivals, size, -1))
        return self.verified(found)

    def verified(self, estimates: Iterable[PoseEstimate | None]) -> list[PoseEstimate]:
        """Return the poses whose score reaches ``min_score``, best first, of each cluster of like poses the best."""
        kept = [estimate for estimate in estimates if estimate is not None and estimate.score >= self.config.min_score]
        if not kept:
            return []
        poses, scores = np.stack([e.T_cam_part for e in kept]), np.array([e.score for e in kept])
        heads, _ = cluster_poses(poses, scores, self.part, self.config.clusters)
        return sorted((kept[k] for k in sorted(heads)), key=lambda estimate: -estimate.score)

    def _scene(self, boundary: BoundaryCloud, frame: Frame) -> _Scene:
        index = index_boundary(boundary.points_cam, boundary.tangents_cam, self.part.d_max)
        return _Scene(frame=frame, boundary=index)

    def _thinned(self, points: Floats, tangents: Floats) -> Group:
        edges = self.config.edges
        kept = thin_points(points, tangents, edges.thinning * self.part.d_max, edges.thinning_angle)
        return points[kept], tangents[kept]

    def _heads(self, raw: RawPoses, count: int | None = None) -> Floats:
        """Return (C, 4, 4) poses that differ, those with most votes first."""
        heads, _ = cluster_poses(raw.T_cam_part, raw.votes, self.part, self.config.clusters)
        return raw.T_cam_part[heads[: count or self.config.most_hypotheses]]

    def _best(self, hypotheses: Floats, group: Group, scene: _Scene, instance_idx: int) -> PoseEstimate | None:
        """Return the hypothesis that explains the group and the frame best, refined."""
        if len(hypotheses) == 0:
            return None
        config = self.config
        looked: list[Looked] = []
        for T in hypotheses:
            if len(looked) >= config.hypotheses and max(verdict.score for _, verdict in looked) >= config.sure:
                break
            looked.append(self._refined(T, group, scene, final=False))
        looked.sort(key=_evidence, reverse=True)
        for k, (T, verdict) in enumerate(looked[: config.finalists]):
            looked[k] = max((T, verdict), self._refined(T, group, scene, final=True), key=_evidence)
        looked.sort(key=_evidence, reverse=True)
        return self._estimate(looked[0], looked[1:], len(group[0]), instance_idx)

    def _estimate(self, best: Looked, rivals: Sequence[Looked], size: int, instance_idx: int) -> PoseEstimate:
        """Return a pose with its score: what speaks for it, and by how much more than for any rival that differs."""
        (T, verdict), config = best, self.config
        poses = np.array([rival for rival, _ in rivals]).reshape(-1, 4, 4)
        alike = are_alike(T, poses, self.part, config.clusters)
        others = [rival.evidence for (_, rival), same in zip(rivals, alike, strict=True) if not same]
        margin = verdict.evidence - max(others, default=-np.inf)
        return PoseEstimate(
            T_cam_part=T,
            score=confidence(verdict, margin, max(size, 1), config.confidence),
            instance_idx=instance_idx,
            visible_fraction=verdict.visible_fraction,
            verdict=verdict,
            margin=margin,
            size=size,
        )

    def _refined(self, T: Floats, group: Group, scene: _Scene, *, final: bool) -> Looked:
        """Return a pose moved onto what was seen, and what speaks for it."""
        config = self.config
        edges = config.edge_refinement if final else config.quick_edges
        surface = config.surface_refinement if final else config.quick_surface
        T = refine_edges(T, self.appearances, scene.boundary, edges).T_cam_part
        T = refine_surface(T, self.surface, scene.frame, surface).T_cam_part
        return T, verify(T, self.appearances, self.surface, scene.boundary, scene.frame, group, config.verification)


def _evidence(looked: Looked) -> float:
    return looked[1].evidence
