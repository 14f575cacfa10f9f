"""``binpick picture``: a settled bin with the arm over it, or what perception makes of a frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from policies.commands.command_line import exit_code, parse

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Make a picture of a settled bin with the arm over it, or of what perception makes of a frame.

    No GL driver is needed.
    """

    show: Literal["cell", "segmentation", "poses"] = "cell"  # segmentation: image, true and predicted parts
    part: str = "tee"  # part_a, part_b, part_c, tee, bracket, or the path of an STL, OBJ or PLY file
    seed: int = 0  # of the pile
    width: int = 1200  # of the picture of the cell [px]
    height: int = 800  # [px]
    out: Path | None = None  # the PNG file; docs/SHOW.png unless given


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and make the picture; return the exit code."""
    return run(parse(Arguments, "picture", arguments))


def run(args: Arguments) -> int:
    """Make the picture; return the exit code."""
    return exit_code(lambda: _draw(args), (ValueError, OSError, RuntimeError))


def _draw(args: Arguments) -> str:
    from policies.report.portrait import cell_picture, save_png

    if args.show == "cell":
        picture = cell_picture(args.part, args.seed, args.width, args.height)
    else:
        picture = (_segmentation if args.show == "segmentation" else _poses)(args.part, args.seed)
    out = args.out or Path("docs") / f"{args.show}.png"
    save_png(picture, out)
    return f"picture   {out}"


def _segmentation(part: str, seed: int) -> "NDArray[np.uint8]":
    from binpick_env.evaluation.segmentation.evaluation import EvaluationConfig, evaluate_scene
    from binpick_env.evaluation.segmentation.method import MethodConfig
    from binpick_env.evaluation.segmentation.pictures import side_by_side
    from binpick_env.scenes.synthesis import SceneConfig
    from perception.segmentation.weights import find_weights

    method = MethodConfig(weights=find_weights(Path(part).stem))
    return side_by_side(evaluate_scene(EvaluationConfig(scenes=SceneConfig(part=part, seed=seed), method=method), 0))


def _poses(part: str, seed: int) -> "NDArray[np.uint8]":
    import numpy as np

    from binpick_env.evaluation.pose.evaluation import PoseEvaluationConfig, evaluate_pose_scene
    from binpick_env.evaluation.pose.method import PoseMethodConfig
    from binpick_env.evaluation.pose.pictures import outlines
    from binpick_env.evaluation.pose.scene_score import PoseSceneScore
    from binpick_env.parts import load_part
    from binpick_env.scenes.synthesis import SceneConfig
    from perception.pose.model.appearances import edge_appearances
    from perception.segmentation.weights import find_weights

    method = PoseMethodConfig(perception="learned", weights=find_weights(Path(part).stem))
    record = evaluate_pose_scene(PoseEvaluationConfig(scenes=SceneConfig(part=part, seed=seed), method=method), 0)
    model = load_part(part).model
    bgr = outlines(record, PoseSceneScore.from_record(record, 0, model), edge_appearances(model))
    return np.ascontiguousarray(bgr[:, :, ::-1])
