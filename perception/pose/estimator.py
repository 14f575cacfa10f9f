"""PPF-MEAM behind one door: boundary points of a group in, the 6-D pose of the part they belong to out.

Reconstructed from the abstract of Liu et al., "PPF-MEAM", Sensors 18 (2018): votes of point pairs give raw poses, which
are clustered modulo symmetry, scored, refined and verified.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from perception.boundary import BoundaryCloud
from perception.frame import Frame, Workspace
from perception.geometry import Floats, require_shape
from perception.instance import Instance
from perception.part import PartModel
from perception.pose.clustering import are_alike, cluster_poses
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.hypotheses.voting import RawPoses, vote
from perception.pose.model.appearances import EdgeAppearances, edge_appearances
from perception.pose.model.edge_models import edge_model
from perception.pose.model.near_symmetry import part_twins
from perception.pose.model.pair_features import build_table
from perception.pose.model.surface_model import SurfaceModel, surface_model
from perception.pose.model.thinning import thin_points
from perception.pose.selection.bodies import body_model
from perception.pose.selection.greedy import arrange
from perception.pose.verification._verification_kernels import near_points
from perception.pose.verification.boundary_index import BoundaryIndex, index_boundary
from perception.pose.verification.confidence import confidence
from perception.pose.verification.perturbation import firmness, small_rotations
from perception.pose.verification.refinement import refine_edges, refine_surface
from perception.pose.verification.verification import Verdict, verify
from perception.runtime.threads import in_threads

RIVALS = 0.25  # of d_max: poses of a scene whose centres are nearer speak of the same points
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
        firmness: By how much it falls, at least, when the part is turned a little.
        size: Boundary points that it was found by, thinned.
    """

    T_cam_part: Floats
    score: float
    instance_idx: int
    visible_fraction: float
    verdict: Verdict
    margin: float
    firmness: float
    size: int

    def __post_init__(self) -> None:
        require_shape("T_cam_part", self.T_cam_part, (4, 4))
        if not 0 <= self.score <= 1:
            raise ValueError(f"score must be in [0, 1], got {self.score}")


@dataclass(frozen=True, eq=False, kw_only=True)
class _Scene:
    """What every group of a frame is compared with."""

    frame: Frame
    boundary: BoundaryIndex


@dataclass(frozen=True, eq=False, kw_only=True)
class _Look:
    """A pose that was looked at, and what speaks for it."""

    T: Floats
    verdict: Verdict
    final: bool  # whether it was refined to the end

    @property
    def evidence(self) -> float:
        return self.verdict.evidence


class PoseEstimator:
    """Finds the poses of one kind of part."""

    def __init__(
        self, part: PartModel, config: EstimatorConfig | None = None, workspace: Workspace | None = None
    ) -> None:
        """Build the part's models; the first time this takes some seconds, later ones read the cache.

        Args:
            part: Its mesh must enclose a volume.
            config: :class:`EstimatorConfig`'s defaults if left out.
            workspace: The bin, if it is known: a pose that reaches through its floor or walls is impossible.

        Raises:
            ValueError: The part's mesh is empty, open or turned inside out.
        """
        self.part = part
        self.config = config or EstimatorConfig()
        self.workspace = workspace
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
        self.body = body_model(part, self.surface)
        self._quick_appearances = self.appearances.every(self.config.quick_step)
        self._quick_surface = surface_model(part, self.config.quick_spacing)
        self._turns = small_rotations(part)
        self._twins = part_twins(part, self.surface, self.config.twins)

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
        """Return the best pose of each group, verified or not; None where none is voted for or possible.

        Note:
            On as many threads as OpenCV may use (`perception.runtime.threads`); the same bits on any number.
        """
        if len(boundary) == 0:
            return [None for _ in instances]
        scene = self._scene(boundary, frame)

        def choice(k: int) -> _Choice:
            idx = instances[k].point_idx
            group = self._thinned(boundary.points_cam[idx], boundary.tangents_cam[idx])
            heads = self._heads(vote(self.table, *group, config=self.config.votes))
            found = _Choice(self, group, scene, self._looks(heads, group, scene), k)
            found.best()  # the work; what is left to the arrangement takes no time
            return found

        return arrange(in_threads(choice, range(len(instances))), self.clash, self.config.min_score)

    def estimate_scene(self, boundary: BoundaryCloud, frame: Frame) -> list[PoseEstimate]:
        """Return the verified poses of a whole scene without groups: PPF-MEAM alone, as before segmentation."""
        if len(boundary) == 0:
            return []
        scene, config = self._scene(boundary, frame), self.config
        cloud = self._thinned(boundary.points_cam, boundary.tangents_cam)
        raw = vote(self.table, *cloud, config=config.votes)
        looks, groups = [], []
        for T in self._heads(raw, config.scene_hypotheses):
            near = near_points(
                T, self.surface.points, self.surface.visible(T), cloud[0], 2 * config.edges.thinning * self.part.d_max
            )
            group = cloud[0][near], cloud[1][near]
            look = self.refined(T, group, scene, final=True)
            if self.possible(look.T, scene.frame):
                looks.append(look)
                groups.append(group)
        centres = np.array([look.T[:3, :3] @ self.part.centre + look.T[:3, 3] for look in looks]).reshape(-1, 3)
        found = []
        for k in range(len(looks)):
            # Two parts cannot lie this deep in each other: poses that do are rivals.
            within = np.linalg.norm(centres - centres[k], axis=1) <= RIVALS * self.part.d_max
            rivals = [looks[j] for j in np.flatnonzero(within) if j != k]
            found.append(self.judged(looks[k], rivals, self.held(looks[k], groups[k], scene), len(groups[k][0]), -1))
        return self.verified(found)

    def verified(self, estimates: Iterable[PoseEstimate | None], min_score: float | None = None) -> list[PoseEstimate]:
        """Return the poses whose score reaches ``min_score``, the configured one unless given; best first.

        Of each cluster of like poses it is the best, and of those that would share room the better one.
        """
        least = self.config.min_score if min_score is None else min_score
        kept = [estimate for estimate in estimates if estimate is not None and estimate.score >= least]
        if not kept:
            return []
        poses, scores = np.stack([e.T_cam_part for e in kept]), np.array([e.score for e in kept])
        heads, _ = cluster_poses(poses, scores, self.part, self.config.clusters)
        standing: list[PoseEstimate] = []
        for estimate in sorted((kept[k] for k in sorted(heads)), key=lambda estimate: -estimate.score):
            if not any(self.clash(other.T_cam_part, estimate.T_cam_part) for other in standing):
                standing.append(estimate)
        return standing

    def possible(self, T_cam_part: Floats, frame: Frame) -> bool:
        """Whether a part can be there, as far as the bin is known."""
        if self.workspace is None:
            return True
        protrusion = self.body.protrusion(frame.T_world_cam @ T_cam_part, self.workspace)
        return protrusion <= self.config.bodies.protrusion * self.part.d_max

    def clash(self, T_cam_a: Floats, T_cam_b: Floats) -> bool:
        """Whether two parts cannot be there at once; like poses are of one part, and do not clash."""
        bodies = self.config.bodies
        if self.body.overlap(T_cam_a, T_cam_b, bodies.depth * self.part.d_max) <= bodies.overlap:
            return False
        return not are_alike(T_cam_a, T_cam_b[None], self.part, self.config.clusters)[0]

    def held(self, look: _Look, group: Group, scene: _Scene) -> float:
        """Return how firmly a pose is held."""

        def evidence(T: Floats) -> float:
            return self._verdict(T, group, scene, self._quick_appearances, self._quick_surface).evidence

        return firmness(look.T, self._turns, evidence)

    def judged(self, best: _Look, rivals: Sequence[_Look], held: float, size: int, instance_idx: int) -> PoseEstimate:
        """Return a pose with its score: what speaks for it, and by how much more than for any that differs."""
        config, verdict = self.config, best.verdict
        poses = np.array([rival.T for rival in rivals]).reshape(-1, 4, 4)
        alike = are_alike(best.T, poses, self.part, config.clusters)
        others = [rival.evidence for rival, same in zip(rivals, alike, strict=True) if not same]
        margin = verdict.evidence - max(others, default=-np.inf)
        return PoseEstimate(
            T_cam_part=best.T,
            score=confidence(verdict, margin, held, max(size, 1), config.confidence),
            instance_idx=instance_idx,
            visible_fraction=verdict.visible_fraction,
            verdict=verdict,
            margin=margin,
            firmness=held,
            size=size,
        )

    def refined(self, T: Floats, group: Group, scene: _Scene, *, final: bool) -> _Look:
        """Return a pose moved onto what was seen, and what speaks for it."""
        config = self.config
        if final:
            T = refine_edges(T, self.appearances, scene.boundary, config.edge_refinement).T_cam_part
            T = refine_surface(T, self.surface, scene.frame, config.surface_refinement).T_cam_part
        else:
            T = refine_edges(T, self._quick_appearances, scene.boundary, config.quick_edges).T_cam_part
            T = refine_surface(T, self._quick_surface, scene.frame, config.quick_surface).T_cam_part
        return _Look(T=T, verdict=self._verdict(T, group, scene, self.appearances, self.surface), final=final)

    def _verdict(
        self, T: Floats, group: Group, scene: _Scene, edges: EdgeAppearances, surface: SurfaceModel
    ) -> Verdict:
        return verify(T, edges, surface, scene.boundary, scene.frame, group, self.config.verification)

    def twins_of(self, look: _Look, group: Group, scene: _Scene) -> list[_Look]:
        """Return the twins of a pose that are not hopeless at first sight."""
        found = []
        for motion in self._twins:
            T = look.T @ motion
            at_sight = self._verdict(T, group, scene, self.appearances, self.surface)
            if at_sight.evidence >= look.evidence - self.config.twins.lead:
                found.append(self.refined(T, group, scene, final=False))
        return found

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

    def _looks(self, hypotheses: Floats, group: Group, scene: _Scene) -> list[_Look]:
        """Look at hypotheses in turn until one is good enough, and return those that are possible."""
        config = self.config
        looks: list[_Look] = []
        for T in hypotheses:
            if len(looks) >= config.hypotheses and max(look.verdict.score for look in looks) >= config.sure:
                break
            look = self.refined(T, group, scene, final=False)
            if self.possible(look.T, scene.frame):
                looks.append(look)
        return looks


class _Choice:
    """The poses that a group may have."""

    def __init__(
        self, estimator: PoseEstimator, group: Group, scene: _Scene, looks: list[_Look], instance_idx: int
    ) -> None:
        self._estimator, self._group, self._scene = estimator, group, scene
        self._looks = looks
        self._held: dict[_Look, float] = {}  # asked for again whenever a rival is ruled out
        self._ruled_out: list[Callable[[Floats], bool]] = []  # by other groups' poses
        self._instance_idx = instance_idx

    def best(self) -> PoseEstimate | None:
        """Return the pose that explains the group and the frame best, refined to the end like its nearest rivals."""
        if not self._looks:
            return None
        self._finish()
        estimator, best = self._estimator, self._looks[0]
        if best not in self._held:
            twins = estimator.twins_of(best, self._group, self._scene)
            self._looks += [twin for twin in twins if self._stands(twin.T)]
            self._finish()
            best = self._looks[0]
            self._held[best] = estimator.held(best, self._group, self._scene)
        return estimator.judged(best, self._looks[1:], self._held[best], len(self._group[0]), self._instance_idx)

    def _finish(self) -> None:
        """Refine the best poses to the end, and put the best one first."""
        estimator, looks = self._estimator, self._looks
        looks.sort(key=_evidence, reverse=True)
        for k, look in enumerate(looks[: estimator.config.finalists]):
            if not look.final:
                final = estimator.refined(look.T, self._group, self._scene, final=True)
                better = final.evidence >= look.evidence and self._stands(final.T)
                looks[k] = final if better else replace(look, final=True)
        looks.sort(key=_evidence, reverse=True)

    def rule_out(self, impossible: Callable[[Floats], bool]) -> bool:
        """Leave out impossible poses; return whether there were any."""
        self._ruled_out.append(impossible)  # for poses that are yet to be looked at
        left = [look for look in self._looks if not impossible(look.T)]
        found, self._looks = len(left) < len(self._looks), left
        return found

    def _stands(self, T_cam_part: Floats) -> bool:
        free = not any(impossible(T_cam_part) for impossible in self._ruled_out)
        return free and self._estimator.possible(T_cam_part, self._scene.frame)


def _evidence(look: _Look) -> float:
    return look.evidence
