"""``binpick evaluate-pose``: recognition, recall and precision of poses on fresh scenes, and the time it takes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from binpick_env.config import AppearanceChoice, SensorPreset
from binpick_env.evaluation.choices import PosePerception
from binpick_env.parts.label import part_label
from perception.segmentation.choices import NetworkName
from policies.commands.cell_arguments import SceneArguments, scenes_of, weights_of
from policies.commands.command_line import exit_code, parse
from policies.commands.worker_arguments import WorkerArguments

if TYPE_CHECKING:
    from binpick_env.evaluation.pose.evaluation import PoseEvaluationConfig
    from binpick_env.scenes.synthesis import SceneConfig
    from perception.pose.estimator_config import EstimatorConfig


@dataclass(frozen=True, kw_only=True)
class Arguments(WorkerArguments, SceneArguments):
    """Estimate the poses of parts in scenes that no training has used; print recognition, recall and precision.

    Every scene is saved as soon as it is finished: the same command resumes where it was stopped. With --ablation,
    variants that each leave one idea out are evaluated on the same scenes and true segments.
    """

    count: int = 20  # number of scenes
    seed: int = 7  # seed of all scenes, which no training has used; scene i is drawn from (seed, i)
    # segments by the network, the true segments, or whole scenes without segments
    perception: PosePerception = "learned"
    network: NetworkName = "grid"  # kind of network, whose weights are found for the part unless --weights are given
    weights: Path | None = None  # segmentation network, a .safetensors file; the one found for the part unless given
    min_score: float | None = None  # smallest score of a verified pose, in [0, 1]; the estimator's own unless given
    sensor: SensorPreset = "good"  # noise of the depth camera
    jitter: bool = True  # vary the camera's pose and the light from scene to scene
    # grey image and surfaces of the parts; varied draws light, blur, labels, wear and deviations for each scene
    appearance: AppearanceChoice = "clean"
    workers: int = 2  # number of processes, each on one core; 1 uses all cores, best for timing
    min_parts: int = 20  # smallest number of parts in a bin
    max_parts: int = 30  # largest number of parts in a bin
    fresh: bool = False  # compute all scenes again, including those that are there
    out: Path | None = None  # folder of the results; runs/pose-eval-PART-PERCEPTION-SEED unless given
    json: Path | None = None  # JSON file for the numbers; results.json in the folder unless given
    html: bool = False  # write report.html with pictures into the folder
    gallery: int = 30  # largest number of scenes in the report, the worst first
    table3: bool = False  # also print the layout of the paper's table 3
    ablation: bool = False  # evaluate variants that each leave one idea out, instead of one method

    def folder(self) -> Path:
        """Return where the results are kept."""
        kind = "pose-ablation" if self.ablation else "pose-eval"
        mode = "" if self.ablation else f"-{self.perception}"
        return self.out or Path("runs") / f"{kind}-{part_label(self.part)}{mode}-{self.seed}"

    def scene_config(self) -> "SceneConfig":
        """Return what the scenes depend on."""
        from binpick_env.scenes.synthesis import SceneConfig

        return SceneConfig(
            **scenes_of(self.options()),
            seed=self.seed,
            num_parts=(self.min_parts, self.max_parts),
            sensor=self.sensor,
            jitter=self.jitter,
            appearance=self.appearance,
        )

    def estimator(self) -> "EstimatorConfig":
        """Return how poses are found."""
        from perception.pose.estimator_config import EstimatorConfig

        default = EstimatorConfig()
        return default if self.min_score is None else replace(default, min_score=self.min_score)

    def config(self) -> "PoseEvaluationConfig":
        """Return what the numbers depend on."""
        from binpick_env.evaluation.pose.evaluation import PoseEvaluationConfig
        from binpick_env.evaluation.pose.method import PoseMethodConfig

        weights = self.weights
        if self.perception == "learned" and weights is None:
            weights = weights_of(self.options(), self.network)
        method = PoseMethodConfig(perception=self.perception, weights=weights, estimator=self.estimator())
        return PoseEvaluationConfig(scenes=self.scene_config(), method=method)


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and evaluate; return the exit code."""
    return run(parse(Arguments, "evaluate-pose", arguments))


def run(args: Arguments) -> int:
    """Evaluate; return the exit code."""
    from binpick_env.cell.settle import SettleError
    from binpick_env.jobs.process_map import WorkerError

    stopped = f"stopped; what is finished is kept in {args.folder()}: the same command goes on"
    work = _ablation if args.ablation else _evaluation
    return exit_code(lambda: work(args), (ValueError, OSError, SettleError, WorkerError), stopped)


def _evaluation(args: Arguments) -> str:
    import numpy as np

    from binpick_env.evaluation.pose.evaluation import evaluate_poses
    from binpick_env.evaluation.pose.report import write_pose_report
    from binpick_env.evaluation.pose.scene_score import load_pose_scores
    from binpick_env.evaluation.pose.summary import summarise_poses
    from binpick_env.evaluation.pose.table import pose_table, table_three
    from binpick_env.evaluation.segmentation.summary import save_summary
    from perception.pose.model.appearances import edge_appearances
    from policies.commands.progress import ProgressBar

    config, out = args.config(), args.folder()
    done = evaluate_poses(config, args.count, out, args.places(), fresh=args.fresh)
    for _ in ProgressBar(done, total=args.count, desc=args.part, unit="scene", smoothing=0.02):
        pass
    part = config.load().part
    scores = load_pose_scores(out, args.count, part)
    summary = summarise_poses(config, scores, np.random.default_rng(args.seed))
    results = args.json or out / "results.json"
    save_summary(results, summary)
    lines = [pose_table(summary), *(["", table_three(summary), ""] if args.table3 else []), f"numbers   {results}"]
    if args.html:
        edges = edge_appearances(part, config.method.estimator.edges)
        write_pose_report(out / "report.html", summary, scores, out, edges, args.gallery)
        lines.append(f"report    {out / 'report.html'}")
    return "\n".join(lines)


def _ablation(args: Arguments) -> str:
    from binpick_env.evaluation.pose.ablation import PoseAblationConfig, pose_rows, run_pose_ablation
    from binpick_env.evaluation.pose.ablation_table import pose_ablation_table
    from binpick_env.evaluation.segmentation.summary import save_summary
    from policies.commands.progress import ProgressBar

    out, rows = args.folder(), pose_rows(args.estimator())
    config = PoseAblationConfig(scenes=args.scene_config(), count=args.count, rows=rows)
    with ProgressBar(desc=args.part, bar_format="{desc} · {elapsed}{postfix}") as bar:
        table = run_pose_ablation(config, out, args.places(), fresh=args.fresh, report=bar.set_description_str)
    results = args.json or out / "results.json"
    save_summary(results, table)
    return f"{pose_ablation_table(table)}\nnumbers   {results}"
