"""``binpick evaluate-segmentation``: ScanNet's AP on fresh scenes, by visible fraction, and the time it takes."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from binpick_env.config import SensorPreset
from binpick_env.evaluation.choices import SegmentationKind
from policies.commands.cell_arguments import SceneArguments, scenes_of
from policies.commands.command_line import exit_code, parse

if TYPE_CHECKING:
    from binpick_env.evaluation.segmentation.evaluation import EvaluationConfig
    from binpick_env.scenes.synthesis import SceneConfig


@dataclass(frozen=True, kw_only=True)
class Arguments(SceneArguments):
    """Segment scenes that no training has seen, and print how well it went.

    Every scene is kept as it is finished: the same command again goes on where it was stopped. With --ablation, the
    rows of the paper's table 2 are trained first, all with the same small budget, and printed one below the other.
    """

    count: int = 100  # scenes
    seed: int = 7  # scene i's own seed follows from this and i alone; not one that was trained with
    weights: Path | None = None  # a .safetensors file; those found for the part unless given
    method: SegmentationKind = "network"  # euclidean: components of points that lie close together, the floor
    threshold: float | None = None  # embedding distance of one part's points; the grouping's own unless given
    radius: float = 0.002  # euclidean: distance of linked points [m]
    sensor: SensorPreset = "good"  # the depth camera's noise
    jitter: bool = True  # vary the camera's place and the light from scene to scene
    workers: int = 2  # processes, each on one core; 1 computes in this one on all cores: so time it
    min_parts: int = 20  # smallest fill of a bin
    max_parts: int = 30  # largest fill
    fresh: bool = False  # compute every scene again, those that are there already too
    out: Path | None = None  # folder of the results; runs/segmentation-eval-PART-SEED unless given
    json: Path | None = None  # where to write the numbers; results.json in the folder unless given
    html: bool = False  # write report.html into the folder, with pictures
    gallery: int = 30  # scenes that the report shows at most, the worst first
    ablation: bool = False  # the rows of table 2 instead of one method
    training_seeds: int = 3  # ablation: trainings of each row
    steps: int = 1500  # ablation: of each training
    scenes: Path | None = None  # ablation: folder of generate-scenes to train on; made unless given
    validation: Path | None = None  # ablation: folder to choose thresholds on; made unless given

    def folder(self) -> Path:
        """Return where the results are kept."""
        kind = "ablation" if self.ablation else "segmentation-eval"
        return self.out or Path("runs") / f"{kind}-{Path(self.part).stem}-{self.seed}"

    def scene_config(self) -> "SceneConfig":
        """Return what the scenes depend on."""
        from binpick_env.scenes.synthesis import SceneConfig

        return SceneConfig(
            **scenes_of(self.options()),
            seed=self.seed,
            num_parts=(self.min_parts, self.max_parts),
            sensor=self.sensor,
            jitter=self.jitter,
        )

    def config(self) -> "EvaluationConfig":
        """Return what the numbers depend on."""
        from binpick_env.evaluation.segmentation.evaluation import EvaluationConfig
        from binpick_env.evaluation.segmentation.method import MethodConfig
        from perception.segmentation.weights import find_weights

        weights = None
        if self.method == "network":
            weights = self.weights or find_weights(Path(self.part).stem)
        method = MethodConfig(kind=self.method, weights=weights, threshold=self.threshold, radius=self.radius)
        return EvaluationConfig(scenes=self.scene_config(), method=method)


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and evaluate; return the exit code."""
    return run(parse(Arguments, "evaluate-segmentation", arguments))


def run(args: Arguments) -> int:
    """Evaluate; return the exit code."""
    from binpick_env.cell.settle import SettleError
    from binpick_env.jobs.process_map import WorkerError
    from perception.segmentation.training.loop import TrainingError

    stopped = f"stopped; what is finished is kept in {args.folder()}: the same command goes on"
    work = _ablation if args.ablation else _evaluation
    return exit_code(lambda: work(args), (ValueError, OSError, SettleError, WorkerError, TrainingError), stopped)


def _evaluation(args: Arguments) -> str:
    import numpy as np
    from tqdm import tqdm

    from binpick_env.evaluation.segmentation.evaluation import evaluate_scenes
    from binpick_env.evaluation.segmentation.report import write_report
    from binpick_env.evaluation.segmentation.summary import load_scores, save_summary, summarise
    from binpick_env.evaluation.segmentation.table import segmentation_table

    config, out = args.config(), args.folder()
    done = evaluate_scenes(config, args.count, out, args.workers, fresh=args.fresh)
    for _ in tqdm(done, total=args.count, desc=args.part, unit="scene", smoothing=0.02):
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
    from tqdm import tqdm

    from binpick_env.evaluation.segmentation.ablation import AblationConfig, run_ablation
    from binpick_env.evaluation.segmentation.ablation_table import segmentation_ablation_table
    from binpick_env.evaluation.segmentation.summary import save_summary

    config = AblationConfig(
        scenes=args.scene_config(),
        count=args.count,
        training_seeds=args.training_seeds,
        steps=args.steps,
        training=args.scenes,
        validation=args.validation,
    )
    out = args.folder()
    with tqdm(desc=args.part, bar_format="{desc} · {elapsed}") as bar:
        table = run_ablation(config, out, args.workers, bar.set_description_str)
    results = args.json or out / "results.json"
    save_summary(results, table)
    return f"{segmentation_ablation_table(table)}\nnumbers   {results}"
