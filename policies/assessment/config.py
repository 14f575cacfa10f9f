"""The settings of an assessment: which part in which cell, and how much is simulated."""

from dataclasses import dataclass, field, replace

from binpick_env.evaluation.pose.evaluation import PoseEvaluationConfig
from binpick_env.evaluation.pose.method import PoseMethodConfig
from binpick_env.options import CellOptions, evaluated, scenes_of
from binpick_env.part_limits import bin_capacity
from binpick_env.parts.part import Part
from binpick_env.scenes.synthesis import SceneConfig
from perception.segmentation.weights import find_weights
from policies.evaluation.config import EvaluationConfig

SCENES, PICKS = "scenes", "picks"  # folders of the stages' results


@dataclass(frozen=True, kw_only=True)
class AssessmentConfig:
    """Which part in which cell is assessed, on how many scenes and bins."""

    options: CellOptions = field(default_factory=CellOptions)  # part and cell
    seed: int = 7  # seed of scenes and bins, which no training may have used
    scenes: int = 20  # number of scenes that perception is evaluated on
    bins: int = 3  # number of bins that are picked, each with all three kinds of perception
    # smallest and largest number of parts in a bin; a bin that holds fewer gets as many as it holds
    num_parts: tuple[int, int] = (20, 30)

    def __post_init__(self) -> None:
        for name in ("scenes", "bins"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, got {self.seed}")
        low, high = self.num_parts
        if not 1 <= low <= high:
            raise ValueError(f"num_parts must be a rising pair from 1, got {self.num_parts}")

    def parts_in_a_bin(self, part: Part) -> tuple[int, int]:
        """Return the smallest and largest number of parts that are dropped into a bin."""
        low, high = self.num_parts
        room = bin_capacity(part, self.options.cell().bin.inner_size)
        return (low, high) if room >= low else (room, room)

    def perception(self, part: Part) -> PoseEvaluationConfig:
        """Return the evaluation of segments and poses, by the network that is found for the part."""
        scenes = SceneConfig(
            **scenes_of(replace(self.options, hand_eye_mm=0.0)),  # which does not change a scene
            seed=self.seed,
            num_parts=self.parts_in_a_bin(part),
            sensor=self.options.sensor,
        )
        method = PoseMethodConfig(perception="learned", weights=find_weights(part.model).path)
        return PoseEvaluationConfig(scenes=scenes, method=method)

    def picks(self, part: Part) -> EvaluationConfig:
        """Return the evaluation of picks from pixels, whose bins the error budget picks three ways."""
        return EvaluationConfig(**evaluated(self.options), seed=self.seed, num_parts=self.parts_in_a_bin(part))
