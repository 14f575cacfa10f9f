"""Summary of an evaluation of segmentation as plain text."""

import textwrap

import numpy as np

from binpick_env.evaluation.segmentation.summary import SegmentationSummary, weights_name
from binpick_env.jobs.text_tables import WIDTH, columns, counted, number, percent
from perception.runtime.provenance import git_commit

METRICS = ("ap", "ap50", "ap75", "ap25")


def segmentation_table(summary: SegmentationSummary) -> str:
    """Return the table that an evaluation prints."""
    rule = "─" * WIDTH
    facts = (summary.part, method_name(summary), f"sensor {summary.sensor}", f"{counted(summary.scenes, 'scene')}")
    lines = [" · ".join([*facts, f"seed {summary.seed}"]), "═" * WIDTH, *_headline(summary), rule]
    lines += [columns(band_rows(summary)), rule, *_facts(summary), rule, *textwrap.wrap(f"NOTE  {summary.note}", WIDTH)]
    if summary.git_commits != [git_commit()]:
        made = ", ".join(name or "unknown" for name in summary.git_commits)
        now = git_commit() or "unknown"
        lines.append(f"NOTE  scenes were evaluated by commit {made}, this is {now}: --fresh evaluates them again")
    return "\n".join(lines)


def method_name(summary: SegmentationSummary) -> str:
    """Return a short name of the method: the file of its weights, or its radius."""
    if summary.weights is None:
        return f"components of radius {1000 * summary.method['radius']:g} mm"
    return weights_name(summary.weights)


def band_rows(summary: SegmentationSummary) -> list[tuple[str, ...]]:
    """Return the header and rows of the table by visible fraction."""
    rows: list[tuple[str, ...]] = [("visible", "parts", "AP", "AP50", "AP75", "AP25", "IoU > .5", "IoU > .75")]
    for band in summary.by_visible_fraction:
        shares = [share(getattr(band, name)) for name in (*METRICS, "found50", "found75")]
        rows.append((f"{band.low:.1f} to {band.high:.1f}", str(band.parts), *shares))
    return rows


def share(value: float) -> str:
    """Return a fraction in per cent without the unit, or a dash for NaN."""
    return "–" if np.isnan(value) else f"{100 * value:.1f}"


def bounds(interval: tuple[float, float]) -> str:
    """Return an interval in per cent without the unit, or a dash for NaN."""
    return "–" if np.isnan(interval[0]) else f"{share(interval[0])} to {share(interval[1])}"


def _headline(summary: SegmentationSummary) -> list[str]:
    rows = [("", "value", "95 % interval", "paper, real Part A")]
    for name in METRICS:
        paper = share(summary.paper[name]) if name in summary.paper else "–"
        rows.append((name.upper(), share(getattr(summary, name)), bounds(summary.intervals[name]), paper))
    return [f"{a:<12}{b:>12}{c:>24}{d:>26}" for a, b, c, d in rows]


def _facts(summary: SegmentationSummary) -> list[str]:
    ms, c = summary.ms, summary.clutter
    threads = " or ".join(map(str, summary.threads))
    lines = [
        f"a scene       {summary.ms_per_scene:.0f} ms from frame to labels on {threads} "
        f"thread{'s' * (summary.threads != [1])}: boundary {ms['boundary']:.0f}, surface {ms['surface']:.0f}, "
        f"network and grouping {ms['segmentation']:.0f}",
        f"points        {summary.points_per_scene:.0f} a scene, all of them labelled and scored; "
        f"{share(summary.wrong_side)} % on the wrong side of a contour",
        f"clutter       visible fraction: median {number(c['median'], 2)}, "
        f"{percent(c['below_half'])} of parts under 0.5, {percent(c['above_nine_tenths'])} over 0.9",
    ]
    if summary.weights is not None:
        commit = summary.weights["git_commit"] or "unknown"
        lines.append(f"weights       {summary.weights['path']}, trained at commit {commit}")
    return lines
