"""The error budget as text and as an HTML page."""

from html import escape
from pathlib import Path

from binpick_env.jobs.report_style import page, table
from binpick_env.jobs.text_tables import columns, counted, number, percent
from perception.runtime.files import write_atomically
from policies.evaluation.budget import COSTS, MODES, Budget, Cost
from policies.evaluation.conditions import GIVEN, given_numbers
from policies.evaluation.failure_attribution import FailureStage
from policies.evaluation.summary import Summary

_RATES = {
    "AP": "ap",
    "AP50": "ap50",
    "AP75": "ap75",
    "pose accuracy": "candidate_pose_accuracy",
    "precision": "candidate_precision",
    "recall": "candidate_recall",
    "GSR": "gsr",
    "DR": "dr",
}
_NAMES = {"gsr": "GSR [points]", "dr": "DR [points]", "mpph": "MPPH"}
NOTE = "Differences of the pooled numbers; in brackets 95 % intervals, paired bootstrap over bins."


def budget_table(budget: Budget) -> str:
    """Return the budget as plain text, for the terminal."""
    title = f"{budget.part} · sensor {budget.sensor} · {counted(budget.bins, 'bin')} · seed {budget.seed}"
    parts = [
        title,
        columns([("", *MODES), *number_rows(budget)]),
        columns([("cost of", *cost_names()), *cost_rows(budget)]),
        NOTE,
    ]
    return "\n\n".join(parts)


def write_budget_report(path: Path, budget: Budget) -> None:
    """Write the page; it links to the evaluations' own reports in the folders beside it."""
    part = escape(Path(budget.part).name)
    rows = [[escape(cell) for cell in row] for row in number_rows(budget)]
    rows.append(["picks", *(f"<a href='{mode}/report.html'>report</a>" for mode in MODES)])
    costs = [[escape(cell) for cell in row] for row in cost_rows(budget)]
    body = (
        f"<h1>Error budget: {part}</h1>"
        f"<p>{counted(budget.bins, 'bin')} · sensor {escape(budget.sensor)} · seed {budget.seed}</p>"
        f"<h2>The same bins three ways</h2><div class='card'>{table(('', *MODES), rows)}</div>"
        f"<h2>What each stage costs</h2><p>{NOTE}</p>"
        f"<div class='card'>{table(('', *cost_names()), costs)}</div>"
    )
    write_atomically(path, page(f"binpick: error budget of {part}", body))


def cost_names() -> list[str]:
    """Return the names of the stages that cost something, each with the two perceptions that it lies between."""
    return [f"{stage} ({given} - {without})" for stage, (given, without) in COSTS.items()]


def number_rows(budget: Budget) -> list[list[str]]:
    """Return the rows of the evaluations' numbers, with failed attempts by stage."""
    summaries = [budget.modes[mode] for mode in MODES]
    rows = [[name, *(_rate(mode, key, budget.modes[mode]) for mode in MODES)] for name, key in _RATES.items()]
    rows.append(["MPPH", *(number(summary.mpph, 0) for summary in summaries)])
    rows.append(["overlapped", *(number(summary.mpph_overlapped, 0) for summary in summaries)])
    times = ("sense", "compute", "motion", "concurrent")
    rows += [[f"{name} [s]", *(number(summary.time[name], 2) for summary in summaries)] for name in times]
    rows.append(["attempts", *(str(summary.attempts) for summary in summaries)])
    rows += [
        [f"failed at {stage}", *(str(summary.failure_attribution[stage]) for summary in summaries)]
        for stage in FailureStage
    ]
    rows.append(["abstentions", *(str(sum(summary.abstentions.values())) for summary in summaries)])
    return rows


def _rate(mode: str, key: str, summary: Summary) -> str:
    return GIVEN if key in given_numbers(mode) else percent(getattr(summary, key))


def cost_rows(budget: Budget) -> list[list[str]]:
    """Return the rows of what each of `cost_names` costs, in points of GSR and DR and in picks per hour."""
    return [[name, *(_cost(budget.costs[stage][key], key) for stage in COSTS)] for key, name in _NAMES.items()]


def _cost(cost: Cost, key: str) -> str:
    digits, unit = (0, 1.0) if key == "mpph" else (1, 100.0)
    if cost.value is None:
        return "–"
    if cost.low is None or cost.high is None:
        return f"{unit * cost.value:+.{digits}f}"
    return f"{unit * cost.value:+.{digits}f} ({unit * cost.low:+.{digits}f} to {unit * cost.high:+.{digits}f})"
