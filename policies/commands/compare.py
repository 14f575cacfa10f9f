"""``binpick compare``: two evaluations of the same bins side by side, with paired intervals."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from policies.commands.command_line import exit_code, parse


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Compare two results of binpick pick that are of the same bins: the same part, bins and seed.

    Perception, sensor, camera, jaw and the code may differ. Differences are those of the second run minus the first.
    """

    # folders of the two runs, as binpick pick --out names them
    runs: Annotated[tuple[Path, Path], tyro.conf.Positional]
    json: Path | None = None  # JSON file for the numbers; none is written unless given
    html: Path | None = None  # HTML file for the page; none is written unless given


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and compare; return the exit code."""
    return run(parse(Arguments, "compare", arguments))


def run(args: Arguments) -> int:
    """Compare; return the exit code."""
    from perception.runtime.records import RecordError

    return exit_code(lambda: _compare(args), (ValueError, OSError, RecordError))


def _compare(args: Arguments) -> str:
    from policies.evaluation.comparison import compare_runs, load_run, save_comparison
    from policies.report.comparison_report import comparison_table, write_comparison_report

    first, second = (load_run(folder) for folder in args.runs)
    comparison = compare_runs(first, second)
    lines = [comparison_table(comparison)]
    if args.json is not None:
        save_comparison(args.json, comparison)
        lines.append(f"numbers   {args.json}")
    if args.html is not None:
        write_comparison_report(args.html, comparison)
        lines.append(f"page      {args.html}")
    return "\n".join(lines)
