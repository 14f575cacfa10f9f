"""6D poses of one kind of part by PPF-MEAM, from groups of boundary points or from a whole scene.

Reconstructed from the abstract of Liu et al., "PPF-MEAM", Sensors 18 (2018). Point pairs vote for poses. These are
clustered modulo symmetry, and the cluster representatives are the hypotheses that are refined, scored and verified.
"""

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from perception.boundary import BoundaryCloud
from perception.depth_edges import depth_std, sampled_rows
from perception.frame import Frame, Workspace, bin_region
from perception.geometry import Floats
from perception.instance import Instance
from perception.part import PartModel
from perception.pose.clustering import are_alike, cluster_poses
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.group_search import GroupSearch
from perception.pose.hypotheses.voting import vote
from perception.pose.hypothesis_scoring import HypothesisScorer, ScoredHypothesis, ScoringModels
from perception.pose.model.appearances import edge_appearances
from perception.pose.model.edge_models import edge_model
from perception.pose.model.near_symmetry import near_symmetries
from perception.pose.model.pair_features import build_table
from perception.pose.model.slides import slides
from perception.pose.model.surface_models import surface_model
from perception.pose.model.thinning import thin_points
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.selection.bodies import body_model
from perception.pose.selection.greedy import select_poses
from perception.pose.selection.leftovers import leftover_groups
from perception.pose.verification._verification_kernels import near_points
from perception.pose.verification.boundary_index import BoundaryIndex, index_boundary
from perception.pose.verification.perturbation import small_rotations
from perception.pose.verification.same_surface import SameSurface
from perception.pose.verification.verification import ObservedGroup
from perception.runtime.threads import in_threads

FARTHEST = 4.0  # distance through the bin's surfaces beyond the tolerance that is impossible [standard deviations]
NOISE_LAG, NOISE_ROWS = 8, 7  # distance of the depths that tell the noise, and step through the rows [px]
RIVAL_DISTANCE = 0.25  # share of d_max; poses of a scene whose centres are nearer are about the same points


class PoseEstimator:
    """Estimates the poses of one kind of part.

    Attributes:
        part: The part that is searched for.
        config: Settings.
        workspace: The bin, or None if it is not known.
        table: Point pair features of the part's edges.
        appearances: Edge points of the part, seen from all directions.
        surface: Samples of the part's surface.
        body: Solid of the part, for collisions.
    """

    def __init__(
        self, part: PartModel, config: EstimatorConfig | None = None, workspace: Workspace | None = None
    ) -> None:
        """Build the part's models, which takes some seconds the first time; later calls read them from the cache.

        Args:
            part: Part to search for; its mesh must enclose a volume.
            config: Settings; the defaults of :class:`EstimatorConfig` if None.
            workspace: The bin, if it is known. Poses that reach through its floor or walls lose score, and
                are impossible where its pose is exact.

        Raises:
            ValueError: The part's mesh is empty, open or turned inside out.
        """
        self.part = part
        self.config = config or EstimatorConfig()
        self.workspace = workspace
        self.table = build_table(edge_model(part, self.config.edges), self.config.pairs, part.symmetry)
        self.appearances = edge_appearances(part, self.config.edges)
        self.surface = surface_model(part)
        self.body = body_model(part, self.surface)
        along = slides(part)
        self._models = ScoringModels(
            part=part,
            edges=self.appearances,
            surface=self.surface,
            coarse_edges=self.appearances.every(self.config.quick_step),
            coarse_surface=surface_model(part, self.config.quick_spacing),
            perturbations=small_rotations(part),
            near_symmetries=np.concatenate([near_symmetries(part, self.surface, self.config.near_symmetry), along]),
            same_surface=SameSurface(self.surface),
        )

    def within(self, workspace: Workspace) -> "PoseEstimator":
        """Return this estimator for another bin, with the same models."""
        other = copy(self)
        other.workspace = workspace
        return other

    def estimate(self, boundary: BoundaryCloud, instances: Sequence[Instance], frame: Frame) -> list[PoseEstimate]:
        """Return the verified poses of groups of boundary points, best first and each part once.

        Args:
            boundary: All boundary points of the frame; with none there are no poses.
            instances: Groups of these points. A group may hold several parts: what the pose of one leaves over is
                searched again. ``instance_idx`` then counts on from the last group.
            frame: Depth image and camera that the points are from.

        Raises:
            ValueError: There are groups, but the frame has no depth.
        """
        estimates = self.estimate_groups(boundary, instances, frame)
        _, more = self.estimate_leftovers(boundary, instances, estimates, frame)
        return self.verified([*estimates, *more])

    def estimate_groups(
        self,
        boundary: BoundaryCloud,
        instances: Sequence[Instance],
        frame: Frame,
        beside: Sequence[PoseEstimate] = (),
    ) -> list[PoseEstimate | None]:
        """Return the selected pose of each group, verified or not; None where no pose is found or possible.

        Args:
            boundary: All boundary points of the frame; with none there are no poses.
            instances: Groups of these points, each of one part.
            frame: Depth image and camera that the points are from.
            beside: Poses of other parts, which no pose may collide with. Poses like them are found all the same.

        Raises:
            ValueError: There are groups, but the frame has no depth.

        Note:
            Runs on as many threads as OpenCV may use (`perception.runtime.threads`), with the same bits on any number.
        """
        if len(boundary) == 0:
            return [None for _ in instances]
        return self.select(self.search_groups(boundary, instances, frame, beside))

    def search_groups(
        self,
        boundary: BoundaryCloud,
        instances: Sequence[Instance],
        frame: Frame,
        beside: Sequence[PoseEstimate] = (),
    ) -> list[GroupSearch]:
        """Return the hypotheses about each group, the first half of :meth:`estimate_groups`; none without points.

        Args:
            boundary: All boundary points of the frame.
            instances: Groups of these points, each of one part.
            frame: Depth image and camera that the points are from.
            beside: Poses of other parts, which no pose may collide with. Poses like them are found all the same.

        Raises:
            ValueError: There are groups, but the frame has no depth.
        """
        if len(boundary) == 0:
            return []
        index = self._index(boundary)

        def penalty(T_cam_part: Floats) -> float:
            clash = any(self.clash(other.T_cam_part, T_cam_part) for other in beside)
            return np.inf if clash else self.penalty(T_cam_part, frame)

        noise = self._noise(frame)
        config = self.config.at_noise(noise, self.part.d_max)

        def search(k: int) -> GroupSearch:
            group = self._thinned_group(boundary.only(instances[k].point_idx), index, frame, noise)
            scorer = HypothesisScorer(self._models, group, config)
            found = GroupSearch(scorer, self.config, penalty, k)
            found.add(self._hypotheses(group, self.config.rough_hypotheses))
            found.best()  # does the work here, on a thread of its own; the selection asks again
            return found

        return in_threads(search, range(len(instances)))

    def select(self, searches: Sequence[GroupSearch]) -> list[PoseEstimate | None]:
        """Return the selected pose of each group that was searched, the second half of :meth:`estimate_groups`."""
        return select_poses(searches, self.clash, self.config.min_score)

    def estimate_leftovers(
        self,
        boundary: BoundaryCloud,
        instances: Sequence[Instance],
        estimates: Sequence[PoseEstimate | None],
        frame: Frame,
    ) -> tuple[list[Instance], list[PoseEstimate | None]]:
        """Search for the parts that a segmentation merged with others: among the points that the poses leave over.

        Args:
            boundary: All boundary points of the frame.
            instances: Groups of these points.
            estimates: Pose of each group by :meth:`estimate_groups`.
            frame: Depth image and camera that the points are from.

        Returns:
            The groups of points that are left over, possibly none, and the pose of each; None where no pose is found,
            or only that of a part that ``estimates`` hold with at least its score. ``instance_idx`` counts on from the
            last of ``instances``.
        """
        groups = leftover_groups(boundary, instances, estimates, self.surface, self.config.leftovers)
        if not groups:
            return [], []
        sure = [e for e in estimates if e is not None and e.score >= self.config.min_score]
        found = self.estimate_groups(boundary, groups, frame, beside=sure)
        new = [None if e is None or self._repeats(e, sure) else e for e in found]
        first = len(instances)
        return groups, [None if e is None else replace(e, instance_idx=first + e.instance_idx) for e in new]

    def estimate_scene(self, boundary: BoundaryCloud, frame: Frame) -> list[PoseEstimate]:
        """Return the verified poses of a whole scene without groups, best first: PPF-MEAM without segmentation.

        Args:
            boundary: All boundary points of the frame; with none there are no poses.
            frame: Depth image and camera that the points are from.

        Raises:
            ValueError: The frame has no depth.
        """
        if len(boundary) == 0:
            return []
        scene = self._thinned_group(boundary, self._index(boundary), frame, self._noise(frame))
        config = self.config.at_noise(scene.noise, self.part.d_max)
        found: list[tuple[HypothesisScorer, ScoredHypothesis]] = []
        for T_cam_part in self._hypotheses(scene, self.config.scene_hypotheses):
            scorer = HypothesisScorer(self._models, self._points_near(T_cam_part, scene), config)
            hypothesis = scorer.refine_fully(T_cam_part)
            penalty = self.penalty(hypothesis.T_cam_part, frame)
            if np.isfinite(penalty):
                found.append((scorer, replace(hypothesis, penalty=penalty)))
        poses = [hypothesis.T_cam_part for _, hypothesis in found]
        centres = np.array([T[:3, :3] @ self.part.centre + T[:3, 3] for T in poses]).reshape(-1, 3)
        estimates = []
        for k, (scorer, hypothesis) in enumerate(found):
            # Two parts cannot overlap this much: poses this near to each other are rivals.
            near = np.linalg.norm(centres - centres[k], axis=1) <= RIVAL_DISTANCE * self.part.d_max
            rivals = [found[j][1] for j in np.flatnonzero(near) if j != k]
            estimates.append(scorer.estimate(hypothesis, rivals, scorer.score_drop(hypothesis), instance_idx=-1))
        return self.verified(estimates)

    def verified(self, estimates: Iterable[PoseEstimate | None], min_score: float | None = None) -> list[PoseEstimate]:
        """Return the poses whose score is high enough, best first; no two of them are alike or collide.

        Args:
            estimates: Poses in any order; None stands for no pose.
            min_score: Least score of a verified pose, in [0, 1]; that of the configuration if None.
        """
        least = self.config.min_score if min_score is None else min_score
        kept = [estimate for estimate in estimates if estimate is not None and estimate.score >= least]
        if not kept:
            return []
        poses, scores = np.stack([e.T_cam_part for e in kept]), np.array([e.score for e in kept])
        representatives, _ = cluster_poses(poses, scores, self.part, self.config.clusters)
        verified: list[PoseEstimate] = []
        for estimate in sorted((kept[k] for k in sorted(representatives)), key=lambda estimate: -estimate.score):
            if not any(self.clash(other.T_cam_part, estimate.T_cam_part) for other in verified):
                verified.append(estimate)
        return verified

    def penalty(self, T_cam_part: Floats, frame: Frame) -> float:
        """Return what a (4, 4) pose's penetration of the bin takes off its logit; 0 if the bin is not known.

        It is the negative logarithm of the likelihood that the bin's pose is off by that much, and infinite where this
        is practically impossible: beyond the tolerance, if the bin's pose is exact.
        """
        if self.workspace is None:
            return 0.0
        T_world_part = frame.T_world_cam @ T_cam_part
        bodies, d_max = self.config.bodies, self.part.d_max
        excess = self.body.protrusion(T_world_part, self.workspace) - bodies.protrusion * d_max
        if excess <= 0:
            return 0.0
        std = self.workspace.std_at(T_world_part[:3, :3] @ self.part.centre + T_world_part[:3, 3])
        if excess > FARTHEST * std:
            return np.inf
        return 0.5 * (excess / std) ** 2

    def clash(self, T_cam_a: Floats, T_cam_b: Floats) -> bool:
        """Return whether two parts in (4, 4) poses would collide; like poses are of one part and do not."""
        bodies = self.config.bodies
        if self.body.overlap(T_cam_a, T_cam_b, bodies.depth * self.part.d_max) <= bodies.overlap:
            return False
        return not are_alike(T_cam_a, T_cam_b[None], self.part, self.config.clusters)[0]

    def _repeats(self, estimate: PoseEstimate, others: Sequence[PoseEstimate]) -> bool:
        """Return whether a pose is like one of the others that has at least its score."""
        poses = np.array([other.T_cam_part for other in others if other.score >= estimate.score]).reshape(-1, 4, 4)
        return bool(are_alike(estimate.T_cam_part, poses, self.part, self.config.clusters).any())

    def _index(self, boundary: BoundaryCloud) -> BoundaryIndex:
        return index_boundary(boundary.points_cam, boundary.tangents_cam, self.part.d_max)

    def _noise(self, frame: Frame) -> float:
        """Return the standard deviation of a frame's depth in the bin [m]; 0 where too little is measured."""
        u0, v0, u1, v1 = (0, 0, frame.depth.shape[1], frame.depth.shape[0])
        if self.workspace is not None:
            u0, v0, u1, v1 = bin_region(
                self.workspace, frame.K, frame.T_world_cam, (u1, v1), margin=0.0, headroom=0.0
            ).tolist()
        return depth_std(sampled_rows(frame.depth[v0:v1, u0:u1], NOISE_ROWS), NOISE_LAG)

    def _thinned_group(self, points: BoundaryCloud, index: BoundaryIndex, frame: Frame, noise: float) -> ObservedGroup:
        """Return boundary points, thinned like the model's, as the group that hypotheses have to explain."""
        edges = self.config.edges
        kept = thin_points(
            points.points_cam, points.tangents_cam, edges.thinning * self.part.d_max, edges.thinning_angle
        )
        return ObservedGroup(
            points_cam=points.points_cam[kept],
            tangents_cam=points.tangents_cam[kept],
            boundary=index,
            frame=frame,
            noise=noise,
        )

    def _points_near(self, T_cam_part: Floats, scene: ObservedGroup) -> ObservedGroup:
        """Return the points of a scene that lie near the visible surface of a posed part."""
        reach = 2 * self.config.edges.thinning * self.part.d_max
        surface = self.surface
        near = near_points(T_cam_part, surface.points, surface.visible(T_cam_part), scene.points_cam, reach)
        return scene.only(near)

    def _hypotheses(self, group: ObservedGroup, count: int) -> Floats:
        """Return up to ``count`` (C, 4, 4) poses that differ from each other, those with most votes first."""
        raw = vote(self.table, group.points_cam, group.tangents_cam, config=self.config.votes)
        representatives, _ = cluster_poses(raw.T_cam_part, raw.votes, self.part, self.config.clusters)
        return raw.T_cam_part[representatives[:count]]
