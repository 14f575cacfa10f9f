"""All settings of the pose estimation."""

from dataclasses import dataclass, field, replace

from perception.pose.clustering import ClusterConfig
from perception.pose.hypotheses.voting import VoteConfig
from perception.pose.model.edge_models import EdgeModelConfig
from perception.pose.model.near_symmetry import NearSymmetryConfig
from perception.pose.model.pair_features import PairConfig
from perception.pose.selection.bodies import BodyConfig
from perception.pose.selection.leftovers import LeftoverConfig
from perception.pose.verification.confidence import ConfidenceConfig
from perception.pose.verification.joint_refinement import JointRefinement
from perception.pose.verification.refinement import EdgeRefinement, SurfaceRefinement
from perception.pose.verification.verification import TOLERANCE, VerificationConfig

GATE = 3.0  # distance within which a refinement seeks matches, in standard deviations of the depth
NOISIEST = 0.05  # largest noise that widens them, as a share of d_max: a bin of small parts looks noisier than it is
QUIETEST = 3e-5  # smallest noise of the depth that the joint refinement reckons with [m]
TOLERATED = 2.0  # gap with which two surfaces agree, in the same; with three, wrong poses agree nearly as well


@dataclass(frozen=True, kw_only=True)
class EstimatorConfig:
    """Settings of a :class:`~perception.pose.estimator.PoseEstimator`.

    Attributes:
        edges: Definition of an edge, and the views from which pairs are taken.
        pairs: Pair features and their table.
        votes: Accumulator of the votes.
        clusters: Largest difference of poses that count as one.
        quick_step: Step through the edge points of a view in the coarse refinement; 1 uses all of them.
        quick_spacing: Spacing of the surface samples in the coarse refinement, as a share of d_max.
        rough_edges: First refinement of every hypothesis, on boundary points.
        quick_edges: Coarse refinement of the most promising hypotheses on boundary points.
        quick_surface: Coarse refinement of the same on the depth image.
        edge_refinement: Full refinement of the finalists on boundary points.
        joint_refinement: Last refinement of the finalists, on edges in the image and on the depth at once.
        verification: Tolerances, and coefficients of the logit that hypotheses are ranked by.
        confidence: Coefficients of the score.
        bodies: Tolerances for collisions of parts with each other and with the bin.
        near_symmetry: Near-symmetric poses that are tried beside the best hypothesis.
        leftovers: When the points that poses leave over are searched for another part.
        rough_hypotheses: Number of hypotheses of each group that are refined roughly, those with most votes.
        hypotheses: Number of these that are refined coarsely, those that agree best with the boundary points first.
        most_hypotheses: The same number while none of them is good enough.
        sure: Logistic function of the logit with which a hypothesis is good enough, in [0, 1].
        finalists: Number of hypotheses that are refined fully, those with the highest logit first.
        contending: Distance of the logit from the best one's within which they are.
        scene_hypotheses: Number of hypotheses that are tried in a whole scene.
        min_score: Least score of a verified pose, in [0, 1].
    """

    edges: EdgeModelConfig = field(default_factory=EdgeModelConfig)
    pairs: PairConfig = field(default_factory=PairConfig)
    votes: VoteConfig = field(default_factory=VoteConfig)
    clusters: ClusterConfig = field(default_factory=ClusterConfig)
    quick_step: int = 2
    quick_spacing: float = 0.06
    rough_edges: EdgeRefinement = field(default_factory=lambda: EdgeRefinement(gates=(0.05,), iterations=4))
    quick_edges: EdgeRefinement = field(default_factory=lambda: EdgeRefinement(gates=(0.03,), iterations=4))
    quick_surface: SurfaceRefinement = field(default_factory=SurfaceRefinement)
    edge_refinement: EdgeRefinement = field(default_factory=EdgeRefinement)
    joint_refinement: JointRefinement = field(default_factory=JointRefinement)
    verification: VerificationConfig = field(default_factory=VerificationConfig)
    confidence: ConfidenceConfig = field(default_factory=ConfidenceConfig)
    bodies: BodyConfig = field(default_factory=BodyConfig)
    near_symmetry: NearSymmetryConfig = field(default_factory=NearSymmetryConfig)
    leftovers: LeftoverConfig = field(default_factory=LeftoverConfig)
    rough_hypotheses: int = 14
    hypotheses: int = 3
    most_hypotheses: int = 5
    sure: float = 0.9
    finalists: int = 2
    contending: float = 2.0
    scene_hypotheses: int = 100
    min_score: float = 0.9

    def __post_init__(self) -> None:
        counts = ("rough_hypotheses", "hypotheses", "most_hypotheses", "finalists", "scene_hypotheses")
        for name in ("quick_step", *counts):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.most_hypotheses < self.hypotheses:
            raise ValueError(f"most_hypotheses must be at least {self.hypotheses}, got {self.most_hypotheses}")
        if not self.contending >= 0:
            raise ValueError(f"contending must be at least 0, got {self.contending}")
        for name in ("min_score", "sure"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be in [0, 1], got {getattr(self, name)}")

    def at_noise(self, noise: float, d_max: float) -> "EstimatorConfig":
        """Return these settings for a frame whose depth is noisy.

        Gates narrower than three standard deviations are widened to them, and tolerances narrower than two. The joint
        refinement weighs the depth by its noise.

        Args:
            noise: Standard deviation of the depth [m]; no more than 5 % of ``d_max`` counts.
            d_max: Diameter of the part [m].
        """
        noise = min(noise, NOISIEST * d_max)
        finest = GATE * noise
        tolerated = TOLERATED / TOLERANCE * noise
        return replace(
            self,
            rough_edges=replace(self.rough_edges, finest=max(self.rough_edges.finest, finest)),
            quick_edges=replace(self.quick_edges, finest=max(self.quick_edges.finest, finest)),
            quick_surface=replace(self.quick_surface, finest=max(self.quick_surface.finest, finest)),
            edge_refinement=replace(self.edge_refinement, finest=max(self.edge_refinement.finest, finest)),
            joint_refinement=replace(self.joint_refinement, depth_noise=max(noise, QUIETEST)),
            verification=replace(self.verification, noise=max(self.verification.noise, tolerated)),
        )
