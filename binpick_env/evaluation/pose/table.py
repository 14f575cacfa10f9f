"""Summary of an evaluation of poses as plain text, in our layout and in that of the paper's table 3."""

import textwrap
from pathlib import Path

import numpy as np

from binpick_env.evaluation.pose.summary import PAPER, PoseSummary
from binpick_env.evaluation.segmentation.summary import weights_name
from binpick_env.evaluation.segmentation.table import bounds, share
from binpick_env.jobs.text_tables import WIDTH, columns, counted, number, percent
from perception.runtime.provenance import git_commit

SEGMENTS = {
    "learned": "learned segments",
    "gt_masks": "true segments",
    "whole_scene": "the whole scene at once",
}


def pose_table(summary: PoseSummary) -> str:
    """Return the table that an evaluation prints."""
    rule = "─" * WIDTH
    lines = [facts_line(summary), "═" * WIDTH, *_headline(summary), rule, columns(band_rows(summary)), rule]
    lines += [columns(reliability_rows(summary)), rule, *_facts(summary), rule]
    lines += textwrap.wrap(f"NOTE  {summary.note}", WIDTH)
    if summary.git_commits != [git_commit()]:
        made = ", ".join(name or "unknown" for name in summary.git_commits)
        now = git_commit() or "unknown"
        lines.append(f"NOTE  scenes were evaluated by commit {made}, this is {now}: --fresh evaluates them again")
    return "\n".join(lines)


def table_three(summary: PoseSummary) -> str:
    """Return the paper's table 3 (recognition rate and times) beside a column of this evaluation."""
    names = ("Recognition rate [%]", "Segmentation of a scene [ms]", "PPF-MEAM [ms]", "Total [ms]")
    rows: list[tuple[str, ...]] = [("", Path(summary.part).stem, *(f"paper, {part}" for part in PAPER))]
    for k, (name, value) in enumerate(zip(names, _table_three_values(summary), strict=True)):
        papers = (f"{100 * paper[k]:.2f}" if k == 0 else f"{paper[k]:.0f}" for paper in PAPER.values())
        rows.append((name, share(value) if k == 0 else milliseconds(value), *papers))
    searched = "the whole scene" if summary.perception == "whole_scene" else "the three groups nearest to a part"
    what = (
        f"{summary.trials} trials in {counted(summary.scenes, 'scene')} of seed {summary.seed}, "
        f"sensor {summary.sensor}, "
        f"{SEGMENTS[summary.perception]}; 95 % interval of the rate: {bounds(summary.intervals['recognition_rate'])} "
        f"(Wilson). Times are medians on {_threads(summary)}; segmentation is from frame to labelled points. PPF-MEAM "
        f"has searched {searched}; in the paper, 3 to 5 groups. {summary.note}"
    )
    return "\n".join([columns(rows), "─" * WIDTH, *textwrap.wrap(f"NOTE  {what}", WIDTH)])


def _table_three_values(summary: PoseSummary) -> tuple[float, ...]:
    """Return the recognition rate and the times of segmentation (NaN without one), of the poses and in total [ms]."""
    ms = summary.ms
    before = ms["boundary"] + summary.ms_segmentation
    poses = ms["pose"] if summary.perception == "whole_scene" else summary.ms_trials
    segmented = before if summary.perception == "learned" else np.nan
    total = np.nan if summary.perception == "gt_masks" else before + poses
    return summary.recognition_rate, segmented, poses, total


def facts_line(summary: PoseSummary) -> str:
    """Return part, segments, sensor, number of scenes and seed in one line."""
    facts = (summary.part, perception_name(summary), f"sensor {summary.sensor}", f"{counted(summary.scenes, 'scene')}")
    return " · ".join([*facts, f"seed {summary.seed}"])


def perception_name(summary: PoseSummary) -> str:
    """Return a short description of the origin of the segments."""
    name = SEGMENTS[summary.perception]
    return name if summary.weights is None else f"{name} ({weights_name(summary.weights)})"


def headline_rows(summary: PoseSummary) -> list[tuple[str, float, str, tuple[float, float]]]:
    """Return name, value, population and interval of recognition rate, recall and precision."""
    population = {
        "recognition_rate": f"{summary.trials} trials",
        "recall": f"{summary.parts_to_find} parts",
        "precision": f"{summary.verified} poses",
    }
    return [
        (name.replace("_", " "), getattr(summary, name), counted, summary.intervals[name])
        for name, counted in population.items()
    ]


def band_rows(summary: PoseSummary) -> list[tuple[str, ...]]:
    """Return the header and rows of recall by visible fraction."""
    rows: list[tuple[str, ...]] = [("visible", "parts", "found", "recall", "95 %")]
    for band in summary.by_visible_fraction:
        span, interval = f"{band.low:.1f} to {band.high:.1f}", bounds(band.interval) if band.parts else "–"
        rows.append((span, str(band.parts), str(band.found), share(band.recall), interval))
    return rows


def reliability_rows(summary: PoseSummary) -> list[tuple[str, ...]]:
    """Return the header and rows of the share of correct poses by score."""
    rows: list[tuple[str, ...]] = [("score", "poses", "right", "mean score", "share right", "95 %")]
    for each in summary.reliability:
        interval = bounds(each.interval) if each.poses else "–"
        values = (share(each.mean_score), share(each.share), interval)
        rows.append((f"{each.low:.1f} to {each.high:.1f}", str(each.poses), str(each.right), *values))
    return rows


def milliseconds(value: float) -> str:
    """Return a time in whole milliseconds, or a dash for NaN."""
    return "–" if np.isnan(value) else f"{value:.0f}"


def quantiles(values: dict[str, float], unit: str) -> str:
    """Return median and 95 % quantile as text, or a dash without values."""
    if np.isnan(values["median"]):
        return "–"
    return f"median {values['median']:.2f}, 95 % under {values['p95']:.2f} {unit}"


def _headline(summary: PoseSummary) -> list[str]:
    rows = [("", "value", "95 % interval", "of")]
    rows += [(name, share(value), bounds(interval), of) for name, value, of, interval in headline_rows(summary)]
    return [f"{a:<20}{b:>12}{c:>24}{d:>22}" for a, b, c, d in rows]


def _facts(summary: PoseSummary) -> list[str]:
    ms, c, everything = summary.ms, summary.clutter, summary.unverified
    by_group = summary.perception != "whole_scene"
    lines = [
        f"errors        of recognised trials: {quantiles(summary.translation_mm, 'mm')}; "
        f"{quantiles(summary.rotation_deg, 'deg')}",
        f"scores        verified from {summary.min_score:g}; calibration error {share(summary.calibration_error)} %, "
        f"Brier {_three(summary.brier)}; Bregier's AP {share(summary.pose_ap)}",
    ]
    if by_group:
        lines += [
            f"unverified    {everything['poses']:.0f} poses, recall {share(everything['recall'])}, precision "
            f"{share(everything['precision'])}, Bregier's AP {share(summary.unverified_pose_ap)}",
            f"segments      {summary.groups_per_scene:.0f} groups a scene, AP {share(summary.ap)}, AP50 "
            f"{share(summary.ap50)}, AP75 {share(summary.ap75)}; {share(summary.purity)} % of a trial's points on its "
            "part",
        ]
    after, (gain, low, high) = summary.explained, summary.explained_gain["ap"]
    lines.append(
        f"explained     by the poses: AP {share(after['ap'])} ({100 * gain:+.1f}, 95 %: {100 * low:+.1f} to "
        f"{100 * high:+.1f}), AP50 {share(after['ap50'])}, AP75 {share(after['ap75'])}"
    )
    alone = f" ({milliseconds(summary.ms_per_group)} a group; three trials' {milliseconds(summary.ms_trials)})"
    lines += [
        f"a scene       {milliseconds(ms['total'])} ms from frame to poses on {_threads(summary)}: boundary "
        f"{milliseconds(ms['boundary'])}, segmentation {milliseconds(summary.ms_segmentation)}, poses "
        f"{milliseconds(summary.ms_pose)}{alone if by_group else ''}",
        f"clutter       visible fraction: median {number(c['median'], 2)}, "
        f"{percent(c['below_half'])} of parts under 0.5, {percent(c['above_nine_tenths'])} over 0.9",
    ]
    if summary.frame_causes:
        counts = ", ".join(f"{name} in {count}" for name, count in summary.frame_causes.items())
        lines.append(f"causes        {counts} of {summary.scenes} frames")
    if summary.weights is not None:
        commit = summary.weights["git_commit"] or "unknown"
        lines.append(f"weights       {summary.weights['path']}, trained at commit {commit}")
    return [line for text in lines for line in textwrap.wrap(text, WIDTH, subsequent_indent=14 * " ")]


def _threads(summary: PoseSummary) -> str:
    return " or ".join(map(str, summary.threads)) + " thread" + "s" * (summary.threads != [1])


def _three(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.3f}"
