"""Ways to get from a frame to poses behind one door, so that the same evaluation judges all of them."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol, get_args

from binpick_env.config import CellConfig
from binpick_env.evaluation.choices import PosePerception
from binpick_env.evaluation.segmentation.method import MethodConfig, segmenter
from binpick_env.parts import Unit, load_part
from perception.boundary import BoundaryCloud
from perception.frame import Frame
from perception.instance import Instance, true_instances
from perception.part import PartModel
from perception.pose.estimator import PoseEstimator
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.model.surface_models import SurfaceModel
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.selection.explanation import ExplanationConfig
from perception.segmentation.grouping.similarity import GroupingConfig
from perception.segmentation.scene import BoundaryScene
from perception.segmentation.surface import Surface


@dataclass(frozen=True, kw_only=True)
class PoseMethodConfig:
    """How a frame becomes poses.

    Attributes:
        perception: Segments by a trained network ("learned") or the true ones ("gt_masks"), or no segments at all.
        weights: The network's ``.safetensors`` file.
        min_points: Smallest true segment; the default is the smallest group of a trained network.
        estimator: Of the poses.
        explanation: Of segments by the poses.
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
        """The segmentation's settings; None without a network."""
        return None if self.weights is None else MethodConfig(weights=self.weights)

    def settings(self) -> dict[str, Any]:
        """Return the settings as plain values; weights count by their content, wherever they lie."""
        return {**asdict(self), "weights": None if self.network is None else self.network.digest()}


class Estimator(Protocol):
    """What is asked of :class:`perception.pose.estimator.PoseEstimator`."""

    surface: SurfaceModel

    def estimate_groups(
        self, boundary: BoundaryCloud, instances: Sequence[Instance], frame: Frame
    ) -> list[PoseEstimate | None]:
        """Return each instance's pose, None where none was found."""
        ...

    def verified(self, estimates: Iterable[PoseEstimate | None], min_score: float | None = None) -> list[PoseEstimate]:
        """Return those that are delivered."""
        ...

    def estimate_scene(self, boundary: BoundaryCloud, frame: Frame) -> list[PoseEstimate]:
        """Return the poses that are delivered without segments."""
        ...


class PoseMethod:
    """A method with its models built and its network loaded."""

    def __init__(self, config: PoseMethodConfig, part: PartModel) -> None:
        """Build the part's models, which takes seconds the first time.

        Raises:
            WeightsError: The weights do not hold a whole network.
        """
        self.config = config
        self.part = part
        self.warm = False  # whether it has seen anything: the first time is slower
        self.estimator = make_estimator(part, config.estimator)
        self._segmenter = None if config.network is None else segmenter(config.network)

    @property
    def needs_surface(self) -> bool:
        """Whether segments depend on the frame's surface."""
        return self._segmenter is not None

    @property
    def by_group(self) -> bool:
        """Whether poses are searched in segments."""
        return self.config.perception != "whole_scene"

    def segments(self, boundary: BoundaryCloud, surface: Surface | None, scene: BoundaryScene) -> list[Instance]:
        """Return the groups of points; without a network those of the parts that have enough points, all of score 1."""
        if self._segmenter is not None and surface is not None:
            return self._segmenter.segment(boundary, surface, self.part.d_max)
        return true_instances(scene.instance_ids, self.config.min_points)


def make_estimator(part: PartModel, config: EstimatorConfig) -> Estimator:
    """Build the estimator of a part's poses in the standard bin."""
    return PoseEstimator(part, config, CellConfig().bin.workspace())


def pose_method(config: PoseMethodConfig, part: str, unit: Unit | None = None) -> PoseMethod:
    """Return the method, kept from call to call as long as settings, part and weights stay what they are.

    Args:
        config: Of the method.
        part: Catalogue name, or path of a mesh file.
        unit: Of a file's coordinates; the plausible one unless given.
    """
    return _loaded(config, part, unit, None if config.network is None else config.network.digest())


@lru_cache(maxsize=1)
def _loaded(config: PoseMethodConfig, part: str, unit: Unit | None, digest: str | None) -> PoseMethod:  # noqa: ARG001
    return PoseMethod(config, load_part(part, unit=unit).model)
