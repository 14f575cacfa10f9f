"""Pose hypotheses about one group of boundary points: refined, scored, and turned into an estimate."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perception.geometry import Floats
from perception.part import PartModel
from perception.pose.clustering import are_alike
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.model.appearances import EdgeAppearances
from perception.pose.model.surface_models import SurfaceModel
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.verification.confidence import confidence, error_penalty, mismatch_penalty
from perception.pose.verification.expected_error import ExpectedError, expected_error
from perception.pose.verification.joint_refinement import refine_jointly
from perception.pose.verification.mismatch import Mismatch, find_mismatch
from perception.pose.verification.perturbation import score_drop
from perception.pose.verification.refinement import refine_edges, refine_surface
from perception.pose.verification.same_surface import SameSurface
from perception.pose.verification.verification import ObservedGroup, Verdict, edge_scores, verify

_EDGE_PROMISE = 3.0  # coefficient of the edge score while the depth is not yet known to agree or not


@dataclass(frozen=True, eq=False, kw_only=True)
class ScoringModels:
    """Everything about a part that its hypotheses are scored with.

    Attributes:
        part: The part itself.
        edges: Edge points of every view of the part.
        surface: Samples of the part's surface.
        coarse_edges: The same views with fewer edge points.
        coarse_surface: The same surface with fewer samples.
        perturbations: (K, 4, 4) small rotations in the part frame, for the score drop.
        near_symmetries: (S, 4, 4) motions in the part frame after which the part looks nearly the same; slides of a
            long part along its axis are among them.
        same_surface: Tells poses apart that differ in their surface.
    """

    part: PartModel
    edges: EdgeAppearances
    surface: SurfaceModel
    coarse_edges: EdgeAppearances
    coarse_surface: SurfaceModel
    perturbations: Floats
    near_symmetries: Floats
    same_surface: SameSurface


@dataclass(frozen=True, eq=False, kw_only=True)
class RoughHypothesis:
    """A pose hypothesis refined on boundary points alone, with a wide gate.

    Attributes:
        T_cam_part: (4, 4) pose of the part in the camera frame.
        promise: Agreement with the boundary points, by which the hypotheses of a group are sorted.
    """

    T_cam_part: Floats
    promise: float


@dataclass(frozen=True, eq=False, kw_only=True)
class ScoredHypothesis:
    """A refined pose hypothesis.

    Attributes:
        T_cam_part: (4, 4) pose of the part in the camera frame.
        verdict: Agreement of the pose with the boundary points and the depth image.
        final: Whether the full refinement has been tried.
        penalty: What the pose's penetration of the bin takes off the logit; 0 within the bin.
    """

    T_cam_part: Floats
    verdict: Verdict
    final: bool
    penalty: float = 0.0

    @property
    def logit(self) -> float:
        """Weighted sum that hypotheses of one group are ranked by."""
        return self.verdict.logit - self.penalty


class HypothesisScorer:
    """Refines and scores hypotheses about one group of boundary points in its frame."""

    def __init__(self, models: ScoringModels, group: ObservedGroup, config: EstimatorConfig) -> None:
        """Keep references; nothing is computed.

        Args:
            models: Models of the part that is searched for.
            group: Boundary points that a hypothesis has to explain, and the frame they are from.
            config: Settings of refinement, verification and confidence, made for the noise of the frame.
        """
        self._models = models
        self._group = group
        self._config = config
        self._judged: dict[ScoredHypothesis, tuple[Mismatch, ExpectedError]] = {}  # the best one is asked for again

    def refine_roughly(self, T_cam_part: Floats) -> RoughHypothesis:
        """Refine a (4, 4) pose on boundary points in few steps, and tell how well it agrees with them."""
        models, config = self._models, self._config
        T_cam_part = self._on_edges(T_cam_part)
        edge_score, explained = edge_scores(T_cam_part, models.coarse_edges, self._group, config.verification)
        promise = _EDGE_PROMISE * edge_score + config.verification.explained_weight * explained
        return RoughHypothesis(T_cam_part=T_cam_part, promise=promise)

    def refine_coarsely(self, rough: Floats) -> ScoredHypothesis:
        """Refine a roughly refined (4, 4) pose further, on the depth as well, and score it with all model points."""
        models, config = self._models, self._config
        on_edges = refine_edges(rough, models.coarse_edges, self._group.boundary, config.quick_edges)
        fitted = refine_surface(on_edges.T_cam_part, models.coarse_surface, self._group.frame, config.quick_surface)
        return self._scored(fitted.T_cam_part, final=False)

    def refine_fully(self, T_cam_part: Floats) -> ScoredHypothesis:
        """Refine a (4, 4) pose to convergence with all model points, and score the result."""
        models, config = self._models, self._config
        edges_fitted = refine_edges(T_cam_part, models.edges, self._group.boundary, config.edge_refinement)
        T_cam_part = edges_fitted.T_cam_part
        fitted = refine_jointly(T_cam_part, models.edges, models.surface, self._group, config.joint_refinement)
        return self._scored(fitted.T_cam_part, final=True)

    def near_symmetric(self, hypothesis: ScoredHypothesis) -> list[ScoredHypothesis]:
        """Return the near-symmetric poses of a hypothesis, coarsely refined.

        Poses whose logit before refinement is more than ``near_symmetry.lead`` lower are left out.
        """
        least = hypothesis.logit - self._config.near_symmetry.lead
        found = []
        for motion in self._models.near_symmetries:
            T_cam_part = hypothesis.T_cam_part @ motion
            if self._verdict(T_cam_part).logit >= least:
                found.append(self.refine_coarsely(self._on_edges(T_cam_part)))
        return found

    def score_drop(self, hypothesis: ScoredHypothesis) -> float:
        """Return the smallest decrease of a hypothesis' logit under small rotations, computed with few points."""
        models, config = self._models, self._config

        def logit(T_cam_part: Floats) -> float:
            edges, surface = models.coarse_edges, models.coarse_surface
            return verify(T_cam_part, edges, surface, self._group, config.verification).logit

        return score_drop(hypothesis.T_cam_part, models.perturbations, logit)

    def estimate(
        self, best: ScoredHypothesis, rivals: Sequence[ScoredHypothesis], drop: float, instance_idx: int
    ) -> PoseEstimate:
        """Return the estimate that follows from the best hypothesis.

        Args:
            best: Hypothesis to return.
            rivals: Other hypotheses about the same points; those like ``best`` have no influence.
            drop: Score drop of ``best``.
            instance_idx: Index of the group; -1 without groups.
        """
        models, config, verdict = self._models, self._config, best.verdict
        part = models.part
        poses = np.array([rival.T_cam_part for rival in rivals]).reshape(-1, 4, 4)
        alike = are_alike(best.T_cam_part, poses, part, config.clusters)
        logits = np.array([rival.logit for rival in rivals])
        margin = best.logit - float(logits[~alike].max(initial=-np.inf))
        # Only rivals that are nearly as good lower the score, and of those the best one with another surface alone.
        close = np.flatnonzero(~alike & (logits > best.logit - config.confidence.clear))
        order = close[np.argsort(-logits[close], kind="stable")]
        other = next((k for k in order if not models.same_surface.of(best.T_cam_part, poses[k : k + 1])[0]), None)
        elsewhere = best.logit - (float(logits[other]) if other is not None else -np.inf)
        size = max(len(self._group.points_cam), 1)
        mismatch, expected = self._judge(best)
        penalty = mismatch_penalty(mismatch, self._group.noise, config.confidence) - best.penalty
        turned = error_penalty(expected.rotation, config.confidence)
        return PoseEstimate(
            T_cam_part=best.T_cam_part,
            score=confidence(verdict, margin, drop, size, config.confidence, penalty + turned),
            instance_idx=instance_idx,
            visible_fraction=verdict.visible_fraction,
            verdict=verdict,
            margin=margin,
            score_drop=drop,
            size=len(self._group.points_cam),
            surface_score=confidence(verdict, elsewhere, np.inf, size, config.confidence, penalty),
            mismatch=mismatch,
            noise=self._group.noise,
            expected_error=expected,
        )

    def _judge(self, hypothesis: ScoredHypothesis) -> tuple[Mismatch, ExpectedError]:
        """Return what of a hypothesis does not match, and its expected error, whatever its rivals are."""
        if hypothesis not in self._judged:
            models, group, config, T_cam_part = self._models, self._group, self._config, hypothesis.T_cam_part
            self._judged[hypothesis] = (
                find_mismatch(T_cam_part, models.surface, group, config.verification),
                expected_error(
                    T_cam_part, models.part.symmetry, models.edges, models.surface, group, config.joint_refinement
                ),
            )
        return self._judged[hypothesis]

    def _on_edges(self, T_cam_part: Floats) -> Floats:
        models, config = self._models, self._config
        return refine_edges(T_cam_part, models.coarse_edges, self._group.boundary, config.rough_edges).T_cam_part

    def _scored(self, T_cam_part: Floats, *, final: bool) -> ScoredHypothesis:
        return ScoredHypothesis(T_cam_part=T_cam_part, verdict=self._verdict(T_cam_part), final=final)

    def _verdict(self, T_cam_part: Floats) -> Verdict:
        models = self._models
        return verify(T_cam_part, models.edges, models.surface, self._group, self._config.verification)
