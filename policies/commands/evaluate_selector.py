"""``binpick evaluate-selector``: heuristics and trained selectors on the same bins, with paired intervals."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from binpick_env.config import Perception
from binpick_env.jobs.text_tables import counted
from binpick_env.parts.label import part_label
from perception.segmentation.choices import NetworkName
from policies.commands.cell_arguments import CellArguments, evaluated
from policies.commands.command_line import exit_code, parse
from policies.commands.worker_arguments import WorkerArguments
from policies.selection.choices import HEURISTICS

if TYPE_CHECKING:
    from policies.evaluation.config import EvaluationConfig
    from policies.evaluation.jobs import Job
    from policies.evaluation.records import BinRecord


@dataclass(frozen=True, kw_only=True)
class Arguments(WorkerArguments, CellArguments):
    """Let grasp selectors pick the same bins and compare what they deliver.

    Every bin is saved as soon as it is finished: the same command resumes where it was stopped. These options make
    bins hard: --part bracket --min-parts 30 --max-parts 30 --sensor harsh --hand-eye-mm 10. The selector hindsight
    tries the grasp candidates from the same state until one delivers. It is an upper bound for the others, and needs
    several attempts per decision.
    """

    # selectors to compare: heuristics and shipped ones by name, trained ones by their file, hindsight as a bound
    selectors: tuple[str, ...] = HEURISTICS
    bins: int = 50  # number of bins
    seed: int = 0  # seed of all bins; bin i is drawn from (seed, i)
    # learned: everything from pixels; gt_masks: true segments; oracle: true poses of visible parts
    perception: Perception = "learned"
    network: NetworkName = "grid"  # kind of the segmentation network where perception is learned
    min_parts: int = 20  # smallest number of parts in a bin
    max_parts: int = 30  # largest number of parts in a bin
    workers: int = 1  # number of processes, each on one core
    out: Path | None = None  # folder of the records; runs/selectors-PART-PERCEPTION-SENSOR-SEED unless given
    json: Path | None = None  # JSON file for the numbers; selectors.json in the folder unless given

    def config(self) -> "EvaluationConfig":
        """Return what the numbers depend on."""
        from policies.evaluation.config import EvaluationConfig

        return EvaluationConfig(
            **evaluated(self.options()),
            seed=self.seed,
            perception=self.perception,
            network=self.network,
            num_parts=(self.min_parts, self.max_parts),
        )

    def job(self) -> "Job":
        """Return how it is done."""
        from policies.evaluation.jobs import Job

        name = f"selectors-{part_label(self.part)}-{self.perception}-{self.sensor}-{self.seed}"
        return Job(out=self.out or Path("runs") / name, bins=self.bins, workers=self.places())


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and compare; return the exit code."""
    return run(parse(Arguments, "evaluate-selector", arguments))


def run(args: Arguments) -> int:
    """Compare; return the exit code."""
    from policies.evaluation.bin_evaluation import BinError

    stopped = "stopped; finished bins are kept: the same command resumes there"
    return exit_code(lambda: _compare(args), (BinError, ValueError, OSError), stopped)


def _compare(args: Arguments) -> str:
    from policies.commands.progress import ProgressBar
    from policies.evaluation.conditions import conditions
    from policies.selection.evaluation import (
        check_comparable,
        compare_selectors,
        evaluate_selectors,
        save_selector_results,
        selector_table,
    )

    config, job = args.config(), args.job()
    check_comparable(args.selectors)
    config.check()
    with ProgressBar(total=args.bins * len(args.selectors), unit="bin", smoothing=0) as bar:

        def on_bin(name: str, record: "BinRecord") -> None:
            bar.set_postfix(selector=name, last=f"{record.delivered}/{record.parts_total} parts")
            bar.update()

        records = evaluate_selectors(config, job, args.selectors, on_bin)
    best, results = compare_selectors(records, args.seed)
    title = " · ".join([args.part, *conditions(asdict(config)), counted(args.bins, "bin"), f"seed {args.seed}"])
    path = args.json or job.out / "selectors.json"
    save_selector_results(path, config, best, results, records)
    return "\n".join([title, selector_table(best, results), f"kept in {path}"])
