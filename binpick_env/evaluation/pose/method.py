"""Pose estimation methods behind one interface, so that one evaluation compares all of them."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol, get_args

from binpick_env.evaluation.choices import PosePerception
from binpick_env.evaluation.segmentation.method import MethodConfig, segmenter
from binpick_env.options import CellOptions
from perception.boundary import BoundaryCloud
from perception.frame import Frame, Workspace
from perception.instance import Instance, true_instances
from perception.part import PartModel
from perception.pose.estimator import PoseEstimator
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.model.surface_models import SurfaceModel
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.selection.explanation import ExplanationConfig
from perception.runtime.last_result import LastResult
from perception.segmentation.grouping.similarity import GroupingConfig
from perception.segmentation.scene import BoundaryScene
from perception.segmentation.surface import Surface
from perception.shape import shape_signature, shape_values


@dataclass(frozen=True, kw_only=True)
class PoseMethodConfig:
    """Method that turns a frame into poses.

    Attributes:
        perception: Origin of the segments: "learned" for a trained network, "gt_masks" for the true segments,
            "whole_scene" for a search without segments.
        weights: ``.safetensors`` file of the segmentation network, for "learned".
        min_points: Smallest number of points of a true segment; the default is that of a trained network's groups.
        estimator: Configuration of the pose estimator.
        explanation: Configuration of the explanation of segments by poses.
    """

    perception: PosePerception = "gt_masks"
    weights: Path | None = None
    min_points: int = GroupingConfig().min_points
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    explanation: ExplanationConfig = field(default_factory=ExplanationConfig)

    def __post_init__(self) -> None:
        if self.perception not in get_args(PosePerception):
            raise ValueError(
                f"perception must be one of {', '.join(get_args(PosePerception))}, got {self.perception!r}"
            )
        if (self.perception == "learned") != (self.weights is not None):
            raise ValueError(f"weights are for perception 'learned' alone, got {self.perception!r} and {self.weights}")
        if self.min_points < 1:
            raise ValueError(f"min_points must be at least 1, got {self.min_points}")

    @property
    def network(self) -> MethodConfig | None:
        """Segmentation method; None without a network."""
        return None if self.weights is None else MethodConfig(weights=self.weights)

    def settings(self) -> dict[str, Any]:
        """Return the settings as a dict; weights are represented by their SHA-256, whatever their path."""
        return {**asdict(self), "weights": None if self.network is None else self.network.digest()}


class Estimator(Protocol):
    """The methods of :class:`perception.pose.estimator.PoseEstimator` that an evaluation uses."""

    surface: SurfaceModel

    def estimate_groups(
        self, boundary: BoundaryCloud, instances: Sequence[Instance], frame: Frame
    ) -> list[PoseEstimate | None]:
        """Return the pose of each instance; None where none was found."""
        ...

    def estimate_leftovers(
        self,
        boundary: BoundaryCloud,
        instances: Sequence[Instance],
        estimates: Sequence[PoseEstimate | None],
        frame: Frame,
    ) -> tuple[list[Instance], list[PoseEstimate | None]]:
        """Return what the poses leave over of the instances, and the poses found there."""
        ...

    def verified(self, estimates: Iterable[PoseEstimate | None], min_score: float | None = None) -> list[PoseEstimate]:
        """Return the estimates that pass verification."""
        ...

    def estimate_scene(self, boundary: BoundaryCloud, frame: Frame) -> list[PoseEstimate]:
        """Return the verified poses of a search without segments."""
        ...


class PoseMethod:
    """Pose estimation method with the part's models built and the network loaded."""

    def __init__(self, config: PoseMethodConfig, part: PartModel, workspace: Workspace) -> None:
        """Build the part's models, which takes seconds the first time.

        Raises:
            WeightsError: The weights file does not hold a complete network.
        """
        self.config = config
        self.part = part
        self.warm = False  # whether it has processed a frame: the first one takes longer
        self.estimator = make_estimator(part, config.estimator, workspace)
        self._shape = shape_values(shape_signature(part))
        self._segmenter = None if config.network is None else segmenter(config.network)

    @property
    def needs_surface(self) -> bool:
        """Whether the segmentation needs the frame's surface."""
        return self._segmenter is not None

    @property
    def by_group(self) -> bool:
        """Whether poses are searched in each group of points, not in the whole scene."""
        return self.config.perception != "whole_scene"

    def segments(self, boundary: BoundaryCloud, surface: Surface | None, scene: BoundaryScene) -> list[Instance]:
        """Return groups by the network; without one, the true segments of at least ``min_points``, with score 1."""
        if self._segmenter is not None and surface is not None:
            return self._segmenter.segment(boundary, surface, self.part.d_max, self._shape)
        return true_instances(scene.instance_ids, self.config.min_points)


def make_estimator(part: PartModel, config: EstimatorConfig, workspace: Workspace) -> Estimator:
    """Build the pose estimator of a part in a bin."""
    return PoseEstimator(part, config, workspace)


def pose_method(config: PoseMethodConfig, options: CellOptions) -> PoseMethod:
    """Return the method with its models; it is cached until settings, part, bin or weights change.

    Args:
        config: Configuration of the method.
        options: Part, and the bin that it lies in.
    """
    return _loaded(config, options, None if config.network is None else config.network.digest())


@LastResult
def _loaded(config: PoseMethodConfig, options: CellOptions, digest: str | None) -> PoseMethod:  # noqa: ARG001
    return PoseMethod(config, options.load_part().model, options.cell().bin.workspace())
