"""``binpick pick``, the main job: bins are picked, success rates are printed with intervals."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING

from binpick_env.config import Perception
from binpick_env.parts.label import part_label
from perception.segmentation.choices import NetworkName
from policies.commands.cell_arguments import CellArguments, evaluated
from policies.commands.command_line import exit_code, parse
from policies.commands.worker_arguments import WorkerArguments

if TYPE_CHECKING:
    from policies.evaluation.config import EvaluationConfig
    from policies.evaluation.jobs import Job
    from policies.evaluation.records import BinRecord
    from policies.grasping.outcomes import PickResult
    from policies.report.media import BinMedia

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Arguments(WorkerArguments, CellArguments):
    """Pick bins of identical parts and print success rates with intervals.

    Every bin is saved as soon as it is finished: the same command resumes where it was stopped.
    """

    bins: int = 10  # number of bins
    seed: int = 0  # seed of all bins; bin i is drawn from (seed, i)
    # learned: everything from pixels; gt_masks: true segments; oracle: true poses of visible parts
    perception: Perception = "learned"
    network: NetworkName = "grid"  # kind of the segmentation network where perception is learned
    budget: bool = False  # pick the same bins with all three kinds of perception and compare them
    workers: int = 1  # number of processes, each on one core
    min_parts: int = 20  # smallest number of parts in a bin
    max_parts: int = 30  # largest number of parts in a bin
    noise_mm: float = 0.0  # error of the oracle's positions, standard deviation per axis [mm]
    noise_deg: float = 0.0  # error of the oracle's rotations, standard deviation [deg]
    push: bool = True  # push a part without a grasp to where one is clear, before a bin is given up
    put_back: bool = True  # put more than one part in the jaw, found by weight, width or an image, back into the bin
    avoid: bool = True  # pick parts that others seem to lie on only at a second look, and lift them slowly
    max_tilt_deg: float = 50.0  # largest angle between a grasp's approach and the vertical [deg]
    ik_restarts: int = 8  # number of postures that inverse kinematics starts from beside the present one
    look_ahead: bool = True  # take the next frame during the carry, and perceive it while the arm goes home
    fresh: bool = False  # compute all bins again, including those that are there
    out: Path | None = None  # folder of the results; runs/pick-PART-PERCEPTION-SEED (or -budget-SEED) unless given
    json: Path | None = None  # JSON file for the numbers; results.json (or budget.json) in the folder unless given
    html: bool = True  # write report.html (or budget.html) into the folder, with a picture of every pick
    zip: bool = False  # also pack page, pictures, picks.csv and numbers into report.zip in the folder, to mail it
    video: Path | None = None  # film the first bin into this .mp4; slow unless MUJOCO_GL names a GL driver
    video_limit: float = 60.0  # length of the film in simulated time [s]; at double speed it takes half of that
    video_speed: float = 2.0  # simulated seconds shown per second of film
    # record all that the robot sees and does in the first bin into this .rrd, for Rerun's viewer
    rerun: Path | None = None

    def config(self) -> "EvaluationConfig":
        """Return what the numbers depend on.

        Raises:
            ValueError: The largest tilt is not over 0 and at most 90 degrees, or the number of restarts is negative.
        """
        from binpick_env.observation.oracle import PoseNoise
        from policies.evaluation.config import EvaluationConfig
        from policies.grasping.clearance import RankSettings
        from policies.grasping.pushes import PushSettings
        from policies.motion.ik_settings import IkSettings
        from policies.picking.execution import ExecutionSettings
        from policies.picking.load_check import DoubleSettings
        from policies.picking.settings import PickerSettings

        if not 0 < self.max_tilt_deg <= 90:
            raise ValueError(f"max_tilt_deg must be over 0 and at most 90 degrees, got {self.max_tilt_deg}")
        if self.ik_restarts < 0:
            raise ValueError(f"ik_restarts must be at least 0, got {self.ik_restarts}")
        picker = PickerSettings(
            rank=RankSettings(max_tilt=radians(self.max_tilt_deg)),
            ik=IkSettings(restarts=self.ik_restarts),
            push=PushSettings(enabled=self.push),
            doubles=DoubleSettings(put_back=self.put_back),
            execution=ExecutionSettings(look_ahead=self.look_ahead),
            most_buried=PickerSettings.most_buried if self.avoid else 1.0,
        )
        return EvaluationConfig(
            **evaluated(self.options()),
            seed=self.seed,
            perception=self.perception,
            network=self.network,
            picker=picker,
            num_parts=(self.min_parts, self.max_parts),
            pose_noise=PoseNoise(translation=self.noise_mm / 1000, rotation=radians(self.noise_deg)),
        )

    def folder(self) -> Path:
        """Return where the results are kept."""
        kind = "budget" if self.budget else self.perception
        return self.out or Path("runs") / f"pick-{part_label(self.part)}-{kind}-{self.seed}"

    def job(self) -> "Job":
        """Return how it is done."""
        from policies.evaluation.jobs import Job

        media = self.media()
        return Job(out=self.folder(), bins=self.bins, workers=self.places(), fresh=self.fresh, listeners=media)

    def media(self) -> "BinMedia":
        """Return what is made of the bins beside their records."""
        from policies.report.media import BinMedia

        return BinMedia(
            pictures=self.html,
            video=self.video,
            video_limit=self.video_limit,
            video_speed=self.video_speed,
            recording=self.rerun,
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and run the job; return the exit code."""
    return run(parse(Arguments, "pick", arguments))


def run(args: Arguments) -> int:
    """Run the job; return the exit code."""
    from policies.evaluation.bin_evaluation import BinError

    kept = f"finished bins are kept in {args.folder()}"
    stopped = f"stopped; {kept}: the same command resumes there"
    return exit_code(lambda: _pick(args), (BinError, ValueError, OSError, ModuleNotFoundError), stopped)


def _pick(args: Arguments) -> str:
    _log.info("loading the simulator and the libraries of perception")
    from policies.evaluation.budget import MODES, budget_jobs
    from policies.evaluation.tables import part_note
    from policies.report.conclusion import conclude, conclude_budget

    config, job = args.config(), args.job()
    args.media().check(evaluations=len(MODES) if args.budget else 1)
    runs = budget_jobs(config, job) if args.budget else {args.perception: (config, job)}
    parts = [each.check() for each, _ in runs.values()]
    if Path(parts[0].source).suffix:  # a file, not a name of the catalogue
        print(part_note(parts[0]))
    records = {mode: _run(*run) for mode, run in runs.items()}
    if args.budget:
        return conclude_budget(records, runs, job, numbers=args.json, html=args.html, archive=args.zip)
    text = conclude(records[args.perception], config, job, numbers=args.json, html=args.html, archive=args.zip)
    return text if args.video is None else f"{text}\n{_film_note(args)}"


def _film_note(args: Arguments) -> str:
    longest, speed = args.video_limit / args.video_speed, args.video_speed
    return f"film      {args.video}, at {speed:g} times the real speed, so of at most {longest:g} s"


def _run(config: "EvaluationConfig", job: "Job") -> "list[BinRecord]":
    from perception.runtime.provenance import git_commit
    from policies.commands.progress import ProgressBar
    from policies.evaluation.jobs import run_job
    from policies.evaluation.tables import found_note

    tally = {"attempts": 0, "delivered": 0}
    with ProgressBar(total=job.bins, desc=f"{config.part} {config.perception}", unit="bin", smoothing=0) as bar:

        def on_pick(result: "PickResult") -> None:
            tally["attempts"] += result.outcome is not None
            tally["delivered"] += result.delivered
            bar.set_postfix({"last": str(result.ending), **tally})

        def on_bin(record: "BinRecord") -> None:
            bar.set_postfix(last=f"{record.delivered}/{record.parts_total} parts")
            bar.update()

        def on_found(found: "Sequence[BinRecord]") -> None:
            ProgressBar.write(found_note(found, job.bins, git_commit()))

        return run_job(config, job, on_bin, on_pick, on_found=on_found)
