"""``binpick picture``: a settled bin with the arm over it, what perception makes of a frame, or generated parts."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from policies.commands.cell_arguments import CellArguments, scenes_of
from policies.commands.command_line import exit_code, parse

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from binpick_env.options import CellOptions
    from binpick_env.scenes.synthesis import SceneConfig


@dataclass(frozen=True, kw_only=True)
class Arguments(CellArguments):
    """Draw a settled bin with the arm over it, a frame with its segments or poses, or a part of every family.

    No GL driver is needed.
    """

    FILES: ClassVar[tuple[str, ...]] = ("out",)  # options that name a file, and no folder

    # the cell, a frame with true and predicted segments, a frame with poses, or one generated part of each family
    show: Literal["cell", "segmentation", "poses", "families"] = "cell"
    seed: int = 0  # seed of the pile, or index of the generated parts
    width: int = 0  # width of the picture [px]; 0 takes 1200 for the cell and 1280 for a frame
    height: int = 0  # height of the picture [px]; 0 takes 800 for the cell and 960 for a frame
    out: Path | None = None  # PNG file; docs/SHOW.png unless given

    def size(self) -> tuple[int, int]:
        """Return width and height of the picture [px]."""
        width, height = (1200, 800) if self.show == "cell" else (1280, 960)
        return self.width or width, self.height or height

    def options(self) -> "CellOptions":
        """Return the options of the cell, whose camera takes frames of the picture's size."""
        width, height = self.size()
        return super(Arguments, replace(self, width=width, height=height)).options()

    def scenes(self) -> "SceneConfig":
        """Return the scenes, the first of which is drawn."""
        from binpick_env.scenes.synthesis import SceneConfig

        return SceneConfig(**scenes_of(self.options()), sensor=self.sensor, seed=self.seed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and make the picture; return the exit code."""
    return run(parse(Arguments, "picture", arguments))


def run(args: Arguments) -> int:
    """Make the picture; return the exit code."""
    return exit_code(lambda: _draw(args), (ValueError, OSError, RuntimeError))


def _draw(args: Arguments) -> str:
    from policies.report.portrait import cell_picture, save_png

    if args.show == "cell":
        picture = cell_picture(args.options(), args.seed, *args.size())
    elif args.show == "families":
        from policies.report.contact_sheet import family_sheet

        picture = family_sheet(args.seed)
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

    method = MethodConfig(weights=find_weights(scenes.options().load_part().model).path)
    return side_by_side(evaluate_scene(EvaluationConfig(scenes=scenes, method=method), 0))


def _poses(scenes: "SceneConfig") -> "NDArray[np.uint8]":
    import numpy as np

    from binpick_env.evaluation.pose.evaluation import PoseEvaluationConfig, evaluate_pose_scene
    from binpick_env.evaluation.pose.method import PoseMethodConfig
    from binpick_env.evaluation.pose.pictures import outlines
    from binpick_env.evaluation.pose.scene_score import PoseSceneScore
    from perception.pose.model.appearances import edge_appearances
    from perception.segmentation.weights import find_weights

    method = PoseMethodConfig(perception="learned", weights=find_weights(scenes.options().load_part().model).path)
    record = evaluate_pose_scene(PoseEvaluationConfig(scenes=scenes, method=method), 0)
    model = scenes.options().load_part().model
    bgr = outlines(record, PoseSceneScore.from_record(record, 0, model), edge_appearances(model))
    return np.ascontiguousarray(bgr[:, :, ::-1])
