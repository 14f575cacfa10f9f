"""Fit how sure a pose is to poses whose truth is known, and show what each smallest score lets pass."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from binpick_env.evaluation.pose.calibration import (
    Sample,
    fit_confidence,
    load_sample,
    operating_points,
    plain_coefficients,
    predicted,
)
from binpick_env.evaluation.pose.evaluation import CONFIG_FILE
from binpick_env.jobs.text_tables import columns
from binpick_env.parts import load_part
from perception.pose.verification.confidence import ConfidenceConfig
from perception.runtime.files import json_text, write_atomically

SCORES = (0.3, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95)


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Read folders of evaluate_pose.py and print the coefficients for `perception/pose/confidence.py`."""

    folders: tuple[Path, ...]  # of evaluate_pose.py, with seeds that nothing is reported on
    json: Path | None = None  # where to write the coefficients


def main(args: Arguments) -> int:
    """Fit; return the exit code."""
    clear = ConfidenceConfig().clear
    try:
        samples = []
        for folder in args.folders:
            note = json.loads((folder / CONFIG_FILE).read_text())
            samples.append(load_sample(folder, load_part(note["part"], unit=note["unit"]).model, clear))
        sample = Sample.join(samples)
        config = fit_confidence(sample)
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    rows = [
        [f"{score:g}", str(passed), f"{100 * precision:.1f} %", f"{100 * recall:.1f} %"]
        for score, passed, precision, recall in operating_points(sample, config, SCORES)
    ]
    print(f"{len(sample.right)} poses, {sample.right.sum()} right; {config}")
    print(columns([["score", "passed", "precision", "recall"], *rows]))
    chance = predicted(sample, config)
    for low in np.arange(0, 1, 0.1):
        inside = (chance >= low) & (chance < low + 0.1 + (low > 0.89))
        if inside.any():
            share = 100 * sample.right[inside].mean()
            print(f"score {low:.1f} to {low + 0.1:.1f}: {share:.0f} % of {inside.sum()} right")
    if args.json is not None:
        write_atomically(args.json, json_text(plain_coefficients(config)))
    return 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Arguments)))
