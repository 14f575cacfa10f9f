"""Fit the noise model of the learned perceiver: let it look at bins, and write how often and how far it errs."""

import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from binpick_env.config import SensorPreset
from binpick_env.evaluation.noise_fit import fit_noise, observe_bins, save_noise
from binpick_env.observation.perception_noise import SHIPPED
from perception.runtime.provenance import command_line, git_commit


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Fit BinPickSelect-v0's pose_noise="learned" to the learned perceiver of one part and sensor."""

    part: str = "tee"  # catalogue name, with weights
    bins: int = 100  # that are looked at, once each
    seed: int = 0  # bin i's own seed follows from this and i alone
    sensor: SensorPreset = "good"  # the depth camera's noise
    min_parts: int = 2  # smallest fill; small ones stand for bins that have been picked for a while
    max_parts: int = 30  # largest fill
    workers: int = 1  # processes; each computes on one core
    json: Path | None = None  # where to write the model; among the shipped ones unless given


def main(args: Arguments) -> int:
    """Fit; return the exit code."""
    filled = args.min_parts, args.max_parts
    try:
        frames = observe_bins(
            args.part, args.bins, args.seed, sensor=args.sensor, num_parts=filled, workers=args.workers
        )
        facts = {"command": command_line(), "commit": git_commit(), "seed": args.seed, "bins": args.bins}
        noise = fit_noise(frames, {**facts, "part": args.part, "sensor": args.sensor, "num_parts": list(filled)})
    except (ValueError, OSError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    path = args.json or SHIPPED / f"{Path(args.part).stem}_{args.sensor}.json"
    save_noise(path, noise)
    print("visible up to   parts   offered   of them wrong")
    for each in noise.bins:
        print(f"{each.high:13.1f} {each.count:7d} {100 * each.offered:7.1f} % {100 * each.wrong:13.1f} %")
    print(f"false candidates a frame: {noise.false_rate:.2f}; kept in {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Arguments)))
