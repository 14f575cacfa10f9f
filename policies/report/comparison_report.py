"""The comparison of two evaluations as text and as an HTML page."""

from collections.abc import Callable
from html import escape
from pathlib import Path
from textwrap import wrap

from binpick_env.jobs.report_style import page, table
from binpick_env.jobs.text_tables import WIDTH, columns, counted
from perception.runtime.files import write_atomically
from policies.evaluation.comparison import BinComparison, Comparison, Difference
from policies.evaluation.conditions import GIVEN
from policies.evaluation.statistics import FEWEST_BINS

_NAMES = {
    "gsr": "GSR, grasp success [%]",
    "dr": "DR, parts delivered [%]",
    "mpph": "MPPH, picks per hour",
    "mpph_overlapped": "MPPH overlapped",
    "ap": "AP, segmentation [%]",
    "candidate_pose_accuracy": "pose accuracy, poses right [%]",
    "candidate_precision": "precision of candidates [%]",
    "candidate_recall": "recall, parts found [%]",
}
_HEADER = ("", "A", "B", "B - A", "95 % of B - A")
_BIN_HEADER = ("bin", "parts", "delivered A", "delivered B", "GSR A", "GSR B", "end A", "end B")
NOTE = (
    "Numbers are pooled over the bins that both runs have; intervals are a paired bootstrap over those bins, from "
    f"{FEWEST_BINS} bins on. MPPH contains the wall clock of the computer. {GIVEN}: the ground truth was given, so "
    "that nothing was measured."
)


def comparison_table(comparison: Comparison) -> str:
    """Return the comparison as plain text, for the terminal."""
    lines = [_title(comparison), f"A  {comparison.first}", f"B  {comparison.second}", *_notes(comparison)]
    return "\n".join([*lines, "", columns([_HEADER, *_rows(comparison)]), "", *wrap(NOTE, WIDTH)])


def write_comparison_report(path: Path, comparison: Comparison) -> None:
    """Write the page in one piece: the numbers, the settings that differ, and every bin side by side."""
    rows = [[escape(cell) for cell in row] for row in _rows(comparison)]
    settings = [[escape(name), escape(f"{a}"), escape(f"{b}")] for name, (a, b) in comparison.settings.items()]
    runs = "".join(f"<p>{name}: <code>{escape(run)}</code></p>" for name, run in _runs(comparison).items())
    notes = "".join(f"<p>{escape(note)}</p>" for note in _notes(comparison))
    differing = table(("setting", "A", "B"), settings, words=(0, 1, 2)) if settings else "<p>none</p>"
    bins = table(_BIN_HEADER, [_bin(each) for each in comparison.bins], words=(6, 7))
    body = (
        f"<h1>Comparison: {escape(Path(comparison.part).name)}</h1><p>{escape(_title(comparison))}</p>{runs}{notes}"
        f"<h2>Numbers</h2><p>{NOTE}</p><div class='card'>{table(_HEADER, rows)}</div>"
        f"<h2>Settings that differ</h2><div class='card'>{differing}</div>"
        f"<h2>Bins</h2><div class='card'>{bins}</div>"
    )
    write_atomically(path, page(f"binpick: comparison on {Path(comparison.part).name}", body))


def _title(comparison: Comparison) -> str:
    return f"{Path(comparison.part).name} · {counted(len(comparison.bins), 'bin')} · seed {comparison.seed}"


def _runs(comparison: Comparison) -> dict[str, str]:
    return {"A": comparison.first, "B": comparison.second}


def _notes(comparison: Comparison) -> list[str]:
    """Return what the reader must know of the two runs."""
    notes = [f"differs: {name}: {a} (A), {b} (B)" for name, (a, b) in comparison.settings.items()]
    if not notes:
        notes.append("NOTE  both runs have the same settings")
    if comparison.left_out:
        notes.append(f"NOTE  left out, in one run only: bins {', '.join(map(str, comparison.left_out))}")
    a, b = (", ".join(commit or "unknown" for commit in commits) for commits in comparison.commits)
    if a != b:
        notes.append(f"NOTE  made by different commits: {a} (A), {b} (B)")
    return notes


def _rows(comparison: Comparison) -> list[list[str]]:
    enough = len(comparison.bins) >= FEWEST_BINS
    return [[_NAMES[key], *_cells(key, difference, enough)] for key, difference in comparison.numbers.items()]


def _cells(key: str, numbers: Difference, enough: bool) -> list[str]:
    show, signed = _formats(key)
    first = GIVEN if "first" in numbers.given else show(numbers.first)
    second = GIVEN if "second" in numbers.given else show(numbers.second)
    interval = "–"
    if enough and numbers.low is not None and numbers.high is not None:
        interval = f"{signed(numbers.low)} to {signed(numbers.high)}"
    return [first, second, signed(numbers.difference), interval]


def _formats(key: str) -> tuple[Callable[[float | None], str], Callable[[float | None], str]]:
    """Return how a number and its differences are written."""
    digits, unit = (0, 1.0) if key.startswith("mpph") else (1, 100.0)

    def show(value: float | None) -> str:
        return "–" if value is None else f"{unit * value:.{digits}f}"

    def signed(value: float | None) -> str:
        return "–" if value is None else f"{round(unit * value, digits) + 0.0:+.{digits}f}"  # no -0.0

    return show, signed


def _bin(each: BinComparison) -> list[str]:
    rates = [f"{s}/{n}" for s, n in zip(each.successes, each.attempts, strict=True)]
    return [str(each.index), str(each.parts_total), *map(str, each.delivered), *rates, *each.termination]
