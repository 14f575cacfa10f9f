"""``binpick calibrate-poses``: a pose's score is fitted to its chance of being right, from poses with known truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from policies.commands.command_line import exit_code, parse

SCORES = (0.3, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95)


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Fit the coefficients of `perception/pose/verification/confidence.py` to folders of evaluate-pose."""

    folders: tuple[Path, ...]  # folders of evaluate-pose, with seeds that no result is reported on
    json: Path | None = None  # JSON file for the coefficients


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and fit; return the exit code."""
    return run(parse(Arguments, "calibrate-poses", arguments))


def run(args: Arguments) -> int:
    """Fit; return the exit code."""
    return exit_code(lambda: _fit(args), (ValueError, OSError))


def _fit(args: Arguments) -> str:
    import json

    import numpy as np

    from binpick_env.evaluation.pose.calibration import (
        Sample,
        fit_confidence,
        load_sample,
        operating_points,
        plain_coefficients,
        predicted_confidence,
    )
    from binpick_env.evaluation.pose.evaluation import CONFIG_FILE
    from binpick_env.jobs.text_tables import columns
    from binpick_env.parts import load_part
    from perception.runtime.files import json_text, write_atomically

    samples = []
    for folder in args.folders:
        note = json.loads((folder / CONFIG_FILE).read_text(encoding="utf-8"))
        part = load_part(
            note["part"],
            unit=note["unit"],
            symmetry=note.get("symmetry", "detect"),
            symmetry_tolerance=note.get("symmetry_tolerance"),
        )
        samples.append(load_sample(folder, part.model))
    sample = Sample.join(samples)
    config = fit_confidence(sample)
    rows = [
        [f"{score:g}", str(passed), f"{100 * precision:.1f} %", f"{100 * recall:.1f} %"]
        for score, passed, precision, recall in operating_points(sample, config, SCORES)
    ]
    lines = [f"{len(sample.correct)} poses, {sample.correct.sum()} right; {config}"]
    lines.append(columns([["score", "passed", "precision", "recall"], *rows]))
    chance = predicted_confidence(sample, config)
    for low in np.arange(0, 1, 0.1):
        inside = (chance >= low) & (chance < low + 0.1 + (low > 0.89))
        if inside.any():
            share = 100 * sample.correct[inside].mean()
            lines.append(f"score {low:.1f} to {low + 0.1:.1f}: {share:.0f} % of {inside.sum()} right")
    if args.json is not None:
        write_atomically(args.json, json_text(plain_coefficients(config)))
    return "\n".join(lines)
