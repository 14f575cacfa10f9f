"""``binpick fit-noise``: the learned perception looks at bins; how often and how far it errs is written as a model."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from policies.commands.cell_arguments import CellArguments
from policies.commands.command_line import exit_code, parse


@dataclass(frozen=True, kw_only=True)
class Arguments(CellArguments):
    """Fit the errors of the learned perception of one part and sensor: BinPickSelect-v0's pose_noise="learned"."""

    bins: int = 100  # number of bins, each observed once
    seed: int = 0  # seed of all bins; bin i is drawn from (seed, i)
    min_parts: int = 2  # smallest number of parts in a bin; small numbers stand for bins that are nearly empty
    max_parts: int = 30  # largest number of parts in a bin
    workers: int = 1  # number of processes, each on one core
    json: Path | None = None  # JSON file for the model; among the shipped ones unless given


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and fit; return the exit code."""
    return run(parse(Arguments, "fit-noise", arguments))


def run(args: Arguments) -> int:
    """Fit; return the exit code."""
    return exit_code(lambda: _fit(args), (ValueError, OSError, RuntimeError))


def _fit(args: Arguments) -> str:
    from binpick_env.evaluation.noise_fit import fit_noise, observe_bins, save_noise
    from binpick_env.observation.perception_noise import SHIPPED
    from binpick_env.parts.label import part_label
    from perception.runtime.provenance import command_line, git_commit

    filled = args.min_parts, args.max_parts
    frames = observe_bins(args.options(), args.bins, args.seed, num_parts=filled, workers=args.workers)
    facts = {"command": command_line(), "commit": git_commit(), "seed": args.seed, "bins": args.bins}
    noise = fit_noise(frames, {**facts, "part": args.part, "sensor": args.sensor, "num_parts": list(filled)})
    path = args.json or SHIPPED / f"{part_label(args.part)}_{args.sensor}.json"
    save_noise(path, noise)
    lines = ["visible up to   parts   offered   of them wrong"]
    lines += [
        f"{each.high:13.1f} {each.count:7d} {100 * each.offered:7.1f} % {100 * each.wrong:13.1f} %"
        for each in noise.bins
    ]
    return "\n".join([*lines, f"false candidates a frame: {noise.false_rate:.2f}; kept in {path}"])
