"""Every setting of the pose estimation, from edges to the score that a pose is verified with."""

from dataclasses import dataclass, field

from perception.pose.clustering import ClusterConfig
from perception.pose.hypotheses.voting import VoteConfig
from perception.pose.model.edge_models import EdgeModelConfig
from perception.pose.model.near_symmetry import TwinConfig
from perception.pose.model.pair_features import PairConfig
from perception.pose.selection.bodies import BodyConfig
from perception.pose.verification.confidence import ConfidenceConfig
from perception.pose.verification.refinement import EdgeRefinement, SurfaceRefinement
from perception.pose.verification.verification import VerificationConfig


@dataclass(frozen=True, kw_only=True)
class EstimatorConfig:
    """How poses are found.

    Attributes:
        edges: What an edge is, and from how many views pairs are taken.
        pairs: Features and table.
        votes: Accumulator.
        clusters: When two poses are one.
        quick_step: Of the edge points of a view, every so many are used to look at a hypothesis ...
        quick_spacing: ... and points of the surface that lie so far apart, as a share of d_max.
        quick_edges: Refinement of every hypothesis, on edges ...
        quick_surface: ... and on the surface.
        edge_refinement: Of those that are left.
        surface_refinement: Of those that are left.
        verification: Tolerances, and the evidence that hypotheses are ranked by.
        confidence: How sure the best one is.
        bodies: What the poses of a scene cannot be at once, and where no part can be.
        twins: Turns after which the part looks nearly the same.
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
    quick_step: int = 2
    quick_spacing: float = 0.06
    quick_edges: EdgeRefinement = field(default_factory=lambda: EdgeRefinement(gates=(0.05, 0.03), iterations=4))
    quick_surface: SurfaceRefinement = field(default_factory=SurfaceRefinement)
    edge_refinement: EdgeRefinement = field(default_factory=EdgeRefinement)
    surface_refinement: SurfaceRefinement = field(default_factory=SurfaceRefinement)
    verification: VerificationConfig = field(default_factory=VerificationConfig)
    confidence: ConfidenceConfig = field(default_factory=ConfidenceConfig)
    bodies: BodyConfig = field(default_factory=BodyConfig)
    twins: TwinConfig = field(default_factory=TwinConfig)
    hypotheses: int = 4
    most_hypotheses: int = 12
    sure: float = 0.9
    finalists: int = 2
    scene_hypotheses: int = 100
    min_score: float = 0.93

    def __post_init__(self) -> None:
        for name in ("quick_step", "hypotheses", "most_hypotheses", "finalists", "scene_hypotheses"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.most_hypotheses < self.hypotheses:
            raise ValueError(f"most_hypotheses must be at least {self.hypotheses}, got {self.most_hypotheses}")
        for name in ("min_score", "sure"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be in [0, 1], got {getattr(self, name)}")
