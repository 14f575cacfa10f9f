"""``binpick picture``: a settled bin with the arm over it, or what perception makes of a frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from policies.commands.cell_arguments import PartArguments, scenes_of
from policies.commands.command_line import exit_code, parse

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from binpick_env.scenes.synthesis import SceneConfig


@dataclass(frozen=True, kw_only=True)
class Arguments(PartArguments):
    """Draw a settled bin with the arm over it, or a frame with its segments or poses.

    No GL driver is needed.
    """

    # the cell, or a frame with true and predicted segments, or a frame with poses
    show: Literal["cell", "segmentation", "poses"] = "cell"
    seed: int = 0  # seed of the pile
    width: int = 1200  # width of the picture of the cell [px]
    height: int = 800  # height of the picture of the cell [px]
    out: Path | None = None  # PNG file; docs/SHOW.png unless given

    def scenes(self) -> "SceneConfig":
        """Return the scenes, the first of which is drawn."""
        from binpick_env.scenes.synthesis import SceneConfig

        return SceneConfig(**scenes_of(self.options()), seed=self.seed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and make the picture; return the exit code."""
    return run(parse(Arguments, "picture", arguments))


def run(args: Arguments) -> int:
    """Make the picture; return the exit code."""
    return exit_code(lambda: _draw(args), (ValueError, OSError, RuntimeError))


def _draw(args: Arguments) -> str:
    from policies.report.portrait import cell_picture, save_png

    if args.show == "cell":
        picture = cell_picture(args.options(), args.seed, args.width, args.height)
    else:
        picture = (_segmentation if args.show == "segmentation" else _poses)(args.scenes())
    out = args.out or Path("docs") / f"{args.show}.png"
    save_png(picture, out)
    return f"picture   {out}"


def _segmentation(scenes: "SceneConfig") -> "NDArray[np.uint8]":
    from binpick_env.evaluation.segmentation.evaluation import EvaluationConfig, evaluate_scene
    from binpick_env.evaluation.segmentation.method import MethodConfig
    from binpick_env.evaluation.segmentation.pictures import side_by_side
    from perception.segmentation.weights import find_weights

    method = MethodConfig(weights=find_weights(Path(scenes.part).stem))
    return side_by_side(evaluate_scene(EvaluationConfig(scenes=scenes, method=method), 0))


def _poses(scenes: "SceneConfig") -> "NDArray[np.uint8]":
    import numpy as np

    from binpick_env.evaluation.pose.evaluation import PoseEvaluationConfig, evaluate_pose_scene
    from binpick_env.evaluation.pose.method import PoseMethodConfig
    from binpick_env.evaluation.pose.pictures import outlines
    from binpick_env.evaluation.pose.scene_score import PoseSceneScore
    from perception.pose.model.appearances import edge_appearances
    from perception.segmentation.weights import find_weights

    method = PoseMethodConfig(perception="learned", weights=find_weights(Path(scenes.part).stem))
    record = evaluate_pose_scene(PoseEvaluationConfig(scenes=scenes, method=method), 0)
    model = scenes.options().load_part().model
    bgr = outlines(record, PoseSceneScore.from_record(record, 0, model), edge_appearances(model))
    return np.ascontiguousarray(bgr[:, :, ::-1])
