"""``binpick evaluate-bin``: how well a bin is measured in frames of a camera whose pose is wrong."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from binpick_env.config import AppearanceChoice, SensorPreset
from policies.commands.cell_arguments import SceneArguments, scenes_of
from policies.commands.command_line import exit_code, parse
from policies.commands.worker_arguments import WorkerArguments


@dataclass(frozen=True, kw_only=True)
class Arguments(WorkerArguments, SceneArguments):
    """Measure the bin in scenes whose camera is reported elsewhere than it is; print the errors and the time."""

    count: int = 100  # number of scenes
    seed: int = 7  # seed of all scenes; scene i is drawn from (seed, i)
    sensor: SensorPreset = "good"  # noise of the depth camera
    appearance: AppearanceChoice = "clean"  # grey image and surfaces of the parts
    min_parts: int = 5  # smallest number of parts in a bin; 0 and 0 for empty bins
    max_parts: int = 30  # largest number of parts in a bin
    off_mm: float = 10.0  # distance of the reported camera from the true one [mm]
    off_deg: float = 2.0  # angle between the two, about an axis through the camera [deg]
    workers: int = 1  # number of processes, each on one core; 1 for timing
    json: Path | None = None  # JSON file for the trials


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and evaluate; return the exit code."""
    return run(parse(Arguments, "evaluate-bin", arguments))


def run(args: Arguments) -> int:
    """Evaluate; return the exit code."""
    return exit_code(lambda: _evaluate(args), (ValueError, OSError, RuntimeError))


def _evaluate(args: Arguments) -> str:
    from binpick_env.evaluation.bin_fit import BinFitConfig, bin_fit_table, measure_bins
    from binpick_env.scenes.synthesis import SceneConfig
    from perception.runtime.files import json_text, write_atomically
    from perception.runtime.provenance import command_line, git_commit
    from policies.commands.progress import ProgressBar

    scenes = SceneConfig(
        **scenes_of(args.options()),
        seed=args.seed,
        num_parts=(args.min_parts, args.max_parts),
        sensor=args.sensor,
        appearance=args.appearance,
    )
    config = BinFitConfig(scenes=scenes, off_mm=args.off_mm, off_deg=args.off_deg)
    found = ProgressBar(measure_bins(config, args.count, args.places()), total=args.count, unit="scene")
    trials = sorted(found, key=lambda trial: trial.index)
    if args.json is not None:
        facts = {"command": command_line(), "commit": git_commit(), "trials": [asdict(trial) for trial in trials]}
        write_atomically(args.json, json_text(facts))
    return bin_fit_table(trials)
