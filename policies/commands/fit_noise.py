"""``binpick fit-noise``: the learned perception looks at bins; how often and how far it errs is written as a model."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from binpick_env.parts.label import part_label
from policies.commands.cell_arguments import CellArguments
from policies.commands.command_line import exit_code, parse
from policies.commands.worker_arguments import WorkerArguments

if TYPE_CHECKING:
    from binpick_env.evaluation.noise import ClassRates, NoiseBins, ObservedBin
    from binpick_env.observation.perception_noise import PerceptionNoise


@dataclass(frozen=True, kw_only=True)
class Arguments(WorkerArguments, CellArguments):
    """Fit the errors of the learned perception of a part, or of every part: BinPickSelect-v0's pose_noise="learned".

    Every bin is saved as soon as it was observed: the same command resumes where it was stopped, and a larger --bins
    adds to those that are there.
    """

    # part_a, part_b, part_c, tee, bracket, or the path of a mesh file; generated: one model for every part, fitted to
    # generated parts, three bins each
    part: str = "tee"
    bins: int = 100  # number of bins, each observed once
    seed: int = 0  # seed of all bins; bin i is drawn from (seed, i)
    min_parts: int = 2  # smallest number of parts in a bin; small numbers stand for bins that are nearly empty
    max_parts: int = 30  # largest number of parts in a bin
    workers: int = 1  # number of processes, each on one core
    out: Path | None = None  # folder of the observed bins; runs/fit-noise-PART-SENSOR-SEED unless given
    json: Path | None = None  # JSON file for the model; among the shipped ones unless given

    def folder(self) -> Path:
        """Return where the observed bins are kept."""
        return self.out or Path("runs") / f"fit-noise-{part_label(self.part)}-{self.sensor}-{self.seed}"

    def config(self) -> "NoiseBins":
        """Return what the observed bins depend on."""
        from binpick_env.evaluation.noise import NoiseBins

        return NoiseBins(options=self.options(), seed=self.seed, num_parts=(self.min_parts, self.max_parts))


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and fit; return the exit code."""
    return run(parse(Arguments, "fit-noise", arguments))


def run(args: Arguments) -> int:
    """Fit; return the exit code."""
    stopped = f"stopped; observed bins are kept in {args.folder()}: the same command resumes there"
    return exit_code(lambda: _fit(args), (ValueError, OSError, RuntimeError), stopped)


def _fit(args: Arguments) -> str:
    from binpick_env.evaluation.noise import load_bins, observe_bins
    from policies.commands.progress import ProgressBar

    config = args.config()
    done = observe_bins(config, args.bins, args.folder(), args.places())
    for _ in ProgressBar(done, total=args.bins, desc=args.part, unit="bin", smoothing=0.02):
        pass
    bins = load_bins(args.folder(), args.bins)
    text = _fit_every_part(args, bins) if config.many else _fit_part(args, bins)
    left_out = sum(each.frame is None for each in bins)
    return f"{text}\nbins left out, whose pile did not come to rest: {left_out}" if left_out else text


def _facts(args: Arguments) -> dict[str, Any]:
    """Return the origin of a model."""
    from perception.runtime.provenance import command_line, git_commit

    facts = {"command": command_line(), "commit": git_commit(), "seed": args.seed, "bins": args.bins}
    filled = [args.min_parts, args.max_parts]
    weights = args.config().weights()
    network = {"name": Path(weights["path"]).name, "sha256": weights["sha256"]}
    return {**facts, "part": args.part, "sensor": args.sensor, "num_parts": filled, "weights": network}


def _fit_part(args: Arguments, bins: "Sequence[ObservedBin]") -> str:
    from binpick_env.evaluation.noise import fit_noise, save_noise
    from binpick_env.observation.perception_noise import SHIPPED

    frames = [each.frame for each in bins if each.frame is not None]
    noise = fit_noise(frames, {**_facts(args), "shape": list(bins[0].signature)})
    path = args.json or SHIPPED / f"{part_label(args.part)}_{args.sensor}.json"
    save_noise(path, noise)
    return f"{_table(noise)}\nfalse candidates a frame: {noise.false_rate:.2f}; kept in {path}"


def _table(noise: "PerceptionNoise") -> str:
    lines = ["visible up to   parts   offered   of them wrong"]
    lines += [
        f"{each.high:13.1f} {each.count:7d} {100 * each.offered:7.1f} % {100 * each.wrong:13.1f} %"
        for each in noise.bins
    ]
    return "\n".join(lines)


def _fit_every_part(args: Arguments, bins: "Sequence[ObservedBin]") -> str:
    from collections import Counter
    from dataclasses import asdict

    import numpy as np

    from binpick_env.evaluation.noise import check_on_left_out_parts, fit_general_noise, save_noise
    from binpick_env.observation.perception_noise import general_file
    from binpick_env.parts.families.generator import VERSION as GENERATOR_VERSION

    designs = {each.part: each for each in bins}
    check = check_on_left_out_parts(bins, np.random.default_rng(args.seed))
    seen = {
        "parts": {name: " ".join(each.part_class) for name, each in designs.items()},
        "generator": GENERATOR_VERSION,
        "training": Counter(each.training for each in designs.values()),
        "check": [asdict(rates) for rates in check],
    }
    noise = fit_general_noise(bins, {**_facts(args), **seen})
    path = args.json or general_file(args.sensor)
    save_noise(path, noise)
    return "\n".join([_check_table(check), f"fitted to {len(designs)} parts; kept in {path}"])


def _check_table(check: "Sequence[ClassRates]") -> str:
    """Return observed rates beside those drawn from fits to other parts."""
    lines = [
        "rates on parts left out of the fit: observed / drawn",
        "shape      parts    seen     offered [%]    of them wrong [%]   false a frame",
    ]
    for each in check:
        offered, wrong = (
            f"{100 * observed:5.1f} / {100 * drawn:5.1f}" for observed, drawn in (each.offered, each.wrong)
        )
        false = f"{each.false[0]:5.2f} / {each.false[1]:5.2f}"
        lines.append(f"{each.shape:9} {each.designs:6d} {each.seen:7d}   {offered}        {wrong}   {false}")
    return "\n".join(lines)
