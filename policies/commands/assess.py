"""``binpick assess``: one part, one page: how it rests, is seen, held, found and picked, and what to do about it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from binpick_env.parts.label import part_label
from policies.commands.cell_arguments import CellArguments
from policies.commands.command_line import exit_code, parse
from policies.commands.worker_arguments import WorkerArguments

if TYPE_CHECKING:
    from binpick_env.options import CellOptions
    from policies.assessment.config import AssessmentConfig
    from policies.assessment.run import AssessmentJob, Progress


@dataclass(frozen=True, kw_only=True)
class Arguments(WorkerArguments, CellArguments):
    """Assess a part on one page: what it is, how it rests, is seen, held, found and picked, and what to do about it.

    A part that the jaw cannot hold is assessed for perception, and no bin is picked. Every scene and bin is saved as
    soon as it is finished: the same command resumes where it was stopped.
    """

    # the part, in place of --part: the path of a mesh file, or a name
    file: Annotated[str | None, tyro.conf.Positional] = None
    scenes: int = 20  # number of scenes that segmentation and poses are evaluated on
    bins: int = 3  # number of bins that are picked, each with true poses, with true segments and from pixels
    seed: int = 7  # seed of scenes and bins, which no training has used
    workers: int = 2  # number of processes, each on one core
    min_parts: int = 20  # smallest number of parts in a bin; a bin that holds fewer gets as many as it holds
    max_parts: int = 30  # largest number of parts in a bin
    fresh: bool = False  # compute all scenes and bins again, including those that are there
    out: Path | None = None  # folder of the results; runs/assess-PART-SEED unless given
    json: Path | None = None  # JSON file for everything that was measured; assessment.json in the folder unless given
    html: bool = True  # write report.html into the folder

    @property
    def named(self) -> str:
        """Part that is assessed, given as the positional argument or by ``--part``."""
        return self.part if self.file is None else self.file

    def options(self) -> "CellOptions":
        """Return part and cell.

        Raises:
            ValueError: The part is named twice, or an option has no meaning.
        """
        if self.file is not None and self.part != CellArguments.part:
            raise ValueError(f"name the part once: {self.file!r} as an argument, or --part {self.part}")
        return super(Arguments, replace(self, part=self.named)).options()

    def folder(self) -> Path:
        """Return where the results are kept."""
        return self.out or Path("runs") / f"assess-{part_label(self.named)}-{self.seed}"

    def config(self) -> "AssessmentConfig":
        """Return what is assessed."""
        from policies.assessment.config import AssessmentConfig

        return AssessmentConfig(
            options=self.options(),
            seed=self.seed,
            scenes=self.scenes,
            bins=self.bins,
            num_parts=(self.min_parts, self.max_parts),
        )

    def job(self, progress: "Progress") -> "AssessmentJob":
        """Return how it is done."""
        from policies.assessment.run import AssessmentJob
        from policies.report.media import BinMedia

        return AssessmentJob(
            out=self.folder(),
            workers=self.places(),
            fresh=self.fresh,
            progress=progress,
            listeners=BinMedia(pictures=self.html),
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and assess; return the exit code."""
    return run(parse(Arguments, "assess", arguments))


def run(args: Arguments) -> int:
    """Assess; return the exit code."""
    from binpick_env.jobs.process_map import WorkerError
    from policies.evaluation.bin_evaluation import BinError

    stopped = f"stopped; what is finished is kept in {args.folder()}: the same command resumes there"
    return exit_code(lambda: _assess(args), (BinError, ValueError, OSError, WorkerError), stopped)


def _assess(args: Arguments) -> str:
    from policies.assessment.assessment import save_assessment
    from policies.assessment.run import assess
    from policies.report.assessment_report import write_assessment_report
    from policies.report.assessment_text import assessment_lines

    done = assess(args.config(), args.job(_bars()))
    numbers = args.json or args.folder() / "assessment.json"
    save_assessment(numbers, done.assessment)
    lines = assessment_lines(done.assessment, numbers)
    if args.html:
        page = args.folder() / "report.html"
        write_assessment_report(page, done, args.folder())
        lines.append(f"report     {page}")
    return "\n".join(lines)


def _bars() -> "Progress":
    """Return a progress bar for each stage."""
    from policies.assessment.run import Progress
    from policies.commands.progress import ProgressBar

    class Bars(Progress):
        def begin(self, stage: str, total: int) -> None:
            counted = "bins (each by 3 perceptions)" if stage == "bins" else stage
            self.bar = ProgressBar(total=total, desc=f"{counted:<7}", unit="step", smoothing=0.02)

        def advance(self) -> None:
            self.bar.update()

        def end(self) -> None:
            self.bar.close()

    return Bars()
