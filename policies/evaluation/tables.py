"""An evaluation's numbers as plain text, for the terminal."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from binpick_env.jobs.text_tables import WIDTH, counted, fine, number, percent, spread
from binpick_env.parts import Part
from policies.evaluation.conditions import GIVEN, conditions, given_numbers
from policies.evaluation.frame_summary import causes_text
from policies.evaluation.records import BinRecord
from policies.evaluation.statistics import FEWEST_BINS, Interval
from policies.evaluation.summary import Summary

_BAR = 24
_NAME = 28  # width of the first column


def result_table(summary: Summary) -> str:
    """Return the table of an evaluation's numbers."""
    config = summary.config
    facts = conditions(config, summary.weights)
    title = " · ".join([config["part"], *facts, counted(summary.bins, "bin"), f"seed {summary.seed}"])
    lines = [
        title,
        "═" * WIDTH,
        *_side_by_side(summary),
        "─" * WIDTH,
        *_headline(summary),
        *_over_bins(summary),
        "─" * WIDTH,
        *_perception(summary),
    ]
    lines += ["─" * WIDTH, *_times(summary), "─" * WIDTH]
    lines += _counts("attempts by outcome", summary.outcomes, summary.attempts)
    lines += _counts("failed attempts by stage", summary.failure_attribution, summary.failures)
    lines += _counts("abstentions by reason", summary.abstentions, sum(summary.abstentions.values()))
    lines += _doubles(summary.doubles)
    if sum(summary.pushes.values()):
        lines += _counts("pushes by outcome", summary.pushes, sum(summary.pushes.values()))
    lines += _counts("bins by their end", summary.termination, summary.bins)
    lines += ["─" * WIDTH, *_parts(summary), *_clutter(summary)]
    if len(summary.git_commits) > 1:
        lines.append(f"NOTE  bins of {len(summary.git_commits)} different commits: {', '.join(summary.git_commits)}")
    return "\n".join(lines)


def _doubles(doubles: Mapping[str, int | dict[str, int]]) -> list[str]:
    """Return what the detectors of more than one part in the jaw said, one line each; none where nothing was lifted."""
    if not doubles.get("lifts"):
        return []
    lines = [f"{'more than one part lifted':<{_NAME}}{doubles['doubles']} of {doubles['lifts']} lifts"]
    for name, counts in doubles.items():
        if isinstance(counts, dict) and counts.get("lifts") != 0:  # an image is taken of light parts alone
            words = ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in counts.items())
            lines.append(f"  {'found by the ' + name if name != 'either' else 'found by either':<{_NAME - 2}}{words}")
    return lines


def found_note(found: Sequence[BinRecord], bins: int, commit: str) -> str:
    """Return a note on the records that existed already, with a warning if other code made them.

    Args:
        found: Records that are not computed again.
        bins: Number of bins of the evaluation.
        commit: Commit of this code.
    """
    made = sorted({record.git_commit for record in found})
    names = ", ".join(name or "unknown" for name in made)
    note = f"{len(found)} of {bins} bins were there already, made by commit {names}"
    if made == [commit]:
        return note
    return f"{note}\nWARNING  this code is commit {commit or 'unknown'}: --fresh computes those bins again"


def part_note(part: Part) -> str:
    """Return how a part's file was read: unit, size, symmetry and density."""
    order = part.model.symmetry.order
    symmetry = "solid of revolution" if np.isinf(order) else f"symmetry order {order:.0f}"
    symmetry = "ball" if part.model.symmetry.sphere else symmetry
    size = f"d_max {1000 * part.model.d_max:.0f} mm"
    return f"{Path(part.source).name}: read as {part.unit}, {size}, {symmetry}, {part.density:g} kg/m^3"


def _side_by_side(summary: Summary) -> list[str]:
    """Return segmentation, poses and picking of the same bins in columns: what is right, beside how much is found."""
    given = given_numbers(summary.config["perception"])
    columns = []
    for name, key, of in (
        ("AP", "ap", "segmentation"),
        ("pose accuracy", "candidate_pose_accuracy", f"of {summary.candidates} poses"),
        ("recall", "candidate_recall", f"of {summary.parts_to_find} parts"),
    ):
        if key in given:
            columns.append((name, GIVEN, of, "not measured"))
        else:
            columns.append((name, percent(getattr(summary, key)), of, _interval(summary.intervals[key])))
    for name, rate, of in (("GSR", summary.gsr_rate, "attempts"), ("DR", summary.dr_rate, "parts")):
        columns.append((name, percent(rate.value), f"of {rate.n} {of}", _interval((rate.low, rate.high))))
    rows = zip(*columns, strict=True)
    return [f"{first:<17}{''.join(f'{cell:<16}' for cell in others)}".rstrip() for first, *others in rows]


def _perception(summary: Summary) -> list[str]:
    error = summary.pose_error
    given = given_numbers(summary.config["perception"])
    segments = GIVEN if "ap" in given else f"AP50 {percent(summary.ap50)}, AP75 {percent(summary.ap75)}"
    note = f" ({GIVEN})" if "candidate_recall" in given else ""
    lines = [
        f"segments      {segments}",
        f"candidates    precision {percent(summary.candidate_precision)}, recall {percent(summary.candidate_recall)} "
        f"of {summary.parts_to_find} parts half visible, in {summary.frames} frames{note}",
        f"poses off by  {fine(error['mm'])} mm, {fine(error['deg'])} deg (medians){note}",
    ]
    if summary.frame_causes:
        lines.append(f"causes        {causes_text(summary.frame_causes, summary.frames)}")
    if summary.perception_ms:
        stages = ", ".join(f"{name} {ms:.0f}" for name, ms in summary.perception_ms.items())
        lines.append(f"a frame       {sum(summary.perception_ms.values()):.0f} ms: {stages} (medians)")
    return lines


def _headline(summary: Summary) -> list[str]:
    rows = [("", "value", "n", "95 % interval")]
    for name, rate in (("GSR  grasp success", summary.gsr_rate), ("DR   declutter", summary.dr_rate)):
        interval = f"{100 * rate.low:.1f} to {100 * rate.high:.1f} %"
        rows.append((name, percent(rate.value), f"{rate.successes}/{rate.n}", interval))
    for name, value, key in (
        ("MPPH mean picks per hour", summary.mpph, "mpph"),
        ("     overlapped", summary.mpph_overlapped, "mpph_overlapped"),
        ("     on motion alone", summary.motion_dph, "motion_dph"),
    ):
        rows.append((name, number(value, 0), str(summary.attempts), spread(summary.intervals[key])))
    return [f"{a:<28}{b:>12}{c:>14}{d:>24}" for a, b, c, d in rows]


def _times(summary: Summary) -> list[str]:
    t, wall = summary.time, summary.wall
    return [
        f"an attempt    sense {number(t['sense'], 2)} s (nominal)   compute {number(t['compute'], 2)} s (wall)   "
        f"motion {number(t['motion'], 2)} s (simulated)",
        f"concurrent    {number(t['concurrent'], 2)} s of sense and compute pass while the attempt before ends",
        f"wall clock    {number(wall['attempt'], 2)} s an attempt, {number(wall['bin'], 1)} s a bin, "
        f"{percent(wall['render_share'])} of it rendering ({summary.camera_backend})",
    ]


def _counts(title: str, counts: dict[str, int], total: int) -> list[str]:
    shown = [(name, count) for name, count in counts.items() if count]
    if not shown:
        return [f"{title:<{_NAME}}none"]
    lines = []
    for k, (name, count) in enumerate(shown):
        bar = "█" * max(1, round(_BAR * count / total))
        lines.append(f"{title if k == 0 else '':<{_NAME}}{name:<20}{count:>5}  {bar}")
    return lines


def _over_bins(summary: Summary) -> list[str]:
    if summary.bins < FEWEST_BINS:
        return [f"over bins     from {FEWEST_BINS} bins on, 95 % intervals from resampling whole bins are shown"]
    gsr, dr = (_interval(summary.intervals[key]) for key in ("gsr_bins", "dr_bins"))
    return [f"over bins     95 % intervals from resampling whole bins: GSR {gsr}, DR {dr}"]


def _interval(interval: Interval | None) -> str:
    return "–" if interval is None else f"{100 * interval[0]:.1f} to {100 * interval[1]:.1f} %"


def _parts(summary: Summary) -> list[str]:
    left = summary.parts_total - summary.delivered - summary.lost
    return [f"parts         {summary.delivered} delivered, {summary.lost} lost, {left} left in the bin"]


def _clutter(summary: Summary) -> list[str]:
    c = summary.clutter
    return [
        f"clutter       visible fraction: median {number(c['median'], 2)}, "
        f"{percent(c['below_half'])} of parts under 0.5, {percent(c['above_nine_tenths'])} over 0.9"
    ]
