"""``binpick evaluate-segmentation``: ScanNet's AP on fresh scenes, by visible fraction, and the time it takes."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from binpick_env.config import AppearanceChoice, SensorPreset
from binpick_env.evaluation.choices import SegmentationKind
from binpick_env.parts.label import part_label
from perception.segmentation.choices import NetworkName
from policies.commands.cell_arguments import SceneArguments, scenes_of, weights_of
from policies.commands.command_line import exit_code, parse
from policies.commands.worker_arguments import WorkerArguments

if TYPE_CHECKING:
    from binpick_env.evaluation.segmentation.evaluation import EvaluationConfig
    from binpick_env.scenes.synthesis import SceneConfig


@dataclass(frozen=True, kw_only=True)
class Arguments(WorkerArguments, SceneArguments):
    """Segment scenes that no training has used, and print average precision (AP) with intervals.

    Every scene is saved as soon as it is finished: the same command resumes where it was stopped. With --ablation, the
    rows of the paper's table 2 are trained first, all with the same small budget, and printed one below the other.
    """

    count: int = 100  # number of scenes
    seed: int = 7  # seed of all scenes, which no training has used; scene i is drawn from (seed, i)
    network: NetworkName = "grid"  # kind of network, whose weights are found for the part unless --weights are given
    weights: Path | None = None  # network to evaluate, a .safetensors file; the one found for the part unless given
    method: SegmentationKind = "network"  # a network, or euclidean: components of points that lie close together
    # largest embedding distance of two points of one part; the grouping's own unless given
    threshold: float | None = None
    radius: float = 0.002  # largest distance of two linked points under --method euclidean [m]
    sensor: SensorPreset = "good"  # noise of the depth camera
    jitter: bool = True  # vary the camera's pose and the light from scene to scene
    # grey image and surfaces of the parts; varied draws light, blur, labels, wear and deviations for each scene
    appearance: AppearanceChoice = "clean"
    workers: int = 2  # number of processes, each on one core; 1 uses all cores, best for timing
    min_parts: int = 20  # smallest number of parts in a bin
    max_parts: int = 30  # largest number of parts in a bin
    fresh: bool = False  # compute all scenes again, including those that are there
    out: Path | None = None  # folder of the results; runs/segmentation-eval-PART-SEED (or ablation-) unless given
    json: Path | None = None  # JSON file for the numbers; results.json in the folder unless given
    html: bool = False  # write report.html with pictures into the folder
    gallery: int = 30  # largest number of scenes in the report, the worst first
    ablation: bool = False  # train and evaluate the rows of the paper's table 2, instead of one method
    training_seeds: int = 3  # number of trainings of each row of the ablation
    steps: int = 1500  # number of steps of each training of the ablation
    scenes: Path | None = None  # folder of generate-scenes that the ablation trains on; made unless given
    # folder of generate-scenes that the ablation chooses thresholds on; made unless given
    validation: Path | None = None

    def folder(self) -> Path:
        """Return where the results are kept."""
        kind = "ablation" if self.ablation else "segmentation-eval"
        return self.out or Path("runs") / f"{kind}-{part_label(self.part)}-{self.seed}"

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

    def config(self) -> "EvaluationConfig":
        """Return what the numbers depend on."""
        from binpick_env.evaluation.segmentation.evaluation import EvaluationConfig
        from binpick_env.evaluation.segmentation.method import MethodConfig

        weights = None
        if self.method == "network":
            weights = self.weights or weights_of(self.options(), self.network)
        method = MethodConfig(kind=self.method, weights=weights, threshold=self.threshold, radius=self.radius)
        return EvaluationConfig(scenes=self.scene_config(), method=method)


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and evaluate; return the exit code."""
    return run(parse(Arguments, "evaluate-segmentation", arguments))


def run(args: Arguments) -> int:
    """Evaluate; return the exit code."""
    from binpick_env.cell.settle import SettleError
    from binpick_env.jobs.process_map import WorkerError
    from perception.segmentation.training.errors import TrainingError

    stopped = f"stopped; what is finished is kept in {args.folder()}: the same command goes on"
    work = _ablation if args.ablation else _evaluation
    return exit_code(lambda: work(args), (ValueError, OSError, SettleError, WorkerError, TrainingError), stopped)


def _evaluation(args: Arguments) -> str:
    import numpy as np

    from binpick_env.evaluation.segmentation.evaluation import evaluate_scenes
    from binpick_env.evaluation.segmentation.report import write_report
    from binpick_env.evaluation.segmentation.summary import load_scores, save_summary, summarise
    from binpick_env.evaluation.segmentation.table import segmentation_table
    from policies.commands.progress import ProgressBar

    config, out = args.config(), args.folder()
    done = evaluate_scenes(config, args.count, out, args.places(), fresh=args.fresh)
    for _ in ProgressBar(done, total=args.count, desc=args.part, unit="scene", smoothing=0.02):
        pass
    scores = load_scores(out, args.count)
    summary = summarise(config, scores, np.random.default_rng(args.seed))
    results = args.json or out / "results.json"
    save_summary(results, summary)
    lines = [segmentation_table(summary), f"numbers   {results}"]
    if args.html:
        write_report(out / "report.html", summary, scores, out, args.gallery)
        lines.append(f"report    {out / 'report.html'}")
    return "\n".join(lines)


def _ablation(args: Arguments) -> str:
    from binpick_env.evaluation.segmentation.ablation import AblationConfig, run_ablation
    from binpick_env.evaluation.segmentation.ablation_table import segmentation_ablation_table
    from binpick_env.evaluation.segmentation.summary import save_summary
    from policies.commands.progress import ProgressBar

    config = AblationConfig(
        scenes=args.scene_config(),
        count=args.count,
        training_seeds=args.training_seeds,
        steps=args.steps,
        training=args.scenes,
        validation=args.validation,
    )
    out = args.folder()
    with ProgressBar(desc=args.part, bar_format="{desc} · {elapsed}{postfix}") as bar:
        table = run_ablation(config, out, args.places(), bar.set_description_str)
    results = args.json or out / "results.json"
    save_summary(results, table)
    return f"{segmentation_ablation_table(table)}\nnumbers   {results}"
