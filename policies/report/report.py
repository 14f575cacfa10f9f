"""``report.html``: the numbers, every bin and every decision, on one page that holds its pictures."""

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from binpick_env.config import GRIPPER_STROKE, CellConfig
from binpick_env.jobs.report_style import bars, figure, page, table, tag, tile
from binpick_env.jobs.text_tables import counted, fine, number, percent, spread
from perception.runtime.files import write_atomically
from policies.evaluation.conditions import GIVEN, conditions, flat_settings, given_numbers
from policies.evaluation.frame_summary import causes_text
from policies.evaluation.records import BinRecord, PickRecord
from policies.evaluation.statistics import Interval, Rate
from policies.evaluation.summary import Summary
from policies.grasping.outcomes import GraspOutcome
from policies.report.bin_map import undelivered_section, undelivered_words
from policies.report.gallery import FAILED_AT, colour, gallery_section, linked_bars, strip, title
from policies.report.pick_csv import picks_csv
from policies.report.picture_source import PictureSource

COLUMNS = (
    "#",
    "result",
    "failed at",
    "part",
    "width [mm]",
    "opening [mm]",
    "score",
    "sense [s]",
    "compute [s]",
    "motion [s]",
    "concurrent [s]",
    "frame",
)
_RANGES = ("num_parts",)  # settings that are the least and the largest value
_ENDS = {"empty": "emptied", "2F": "two failures in a row", "abstained": "nothing left to try", "time": "out of time"}


def write_report(path: Path, summary: Summary, records: Sequence[BinRecord], pictures: Path) -> list[str]:
    """Write the page in one piece, with its pictures and all picks as CSV inside.

    A bin of 25 parts takes 1 MB. Beyond 18 MB the last pictures, those of deliveries, are linked; see `PictureSource`.

    Args:
        path: Path of the HTML file.
        summary: Numbers of the evaluation.
        records: Records of all bins, in order.
        pictures: Folder of the records' pictures.

    Returns:
        Names of the pictures that are not inside the page.
    """
    config = summary.config
    part = Path(config["part"]).name
    source = PictureSource(pictures, path)
    bins = "".join(_bin(record, source) for record in records)  # first, so that their pictures are inside
    gallery = gallery_section(records, source)
    sections = [
        f"<h1>Bin picking: {escape(part)}</h1>",
        f"<p>{counted(summary.bins, 'bin')} of {config['num_parts'][0]} to {config['num_parts'][1]} parts · "
        f"perception {' · '.join(conditions(config))} · frames by {summary.camera_backend} · "
        f"seed {summary.seed}</p>",
        _headline(summary),
        _perception(summary),
        _outcomes(summary),
        undelivered_section(records, config),
        gallery,
        f"<h2>Bins</h2>{_csv_link(records)}{bins}",
        _settings(config),
        _provenance(summary),
    ]
    if source.linked:
        sections.insert(
            1,
            f"<p>{len(source.linked)} pictures of deliveries are files beside this page: it would be too large to mail "
            "with them. <code>--zip</code> packs all into one file.</p>",
        )
    write_atomically(path, page(f"binpick: {part}", "".join(sections)))
    return source.linked


def _headline(summary: Summary) -> str:
    time = summary.time
    parts = " + ".join(f"{name} {number(time[name], 2)}" for name in ("sense", "compute", "motion")) + " s"
    saved = f"{number(time['concurrent'], 2)} s of sense and compute while the attempt before ends"
    mpph, overlapped, motion = (summary.intervals[key] for key in ("mpph", "mpph_overlapped", "motion_dph"))
    tiles = [
        _rate_tile("GSR · grasp success", summary.gsr_rate, "attempts"),
        _rate_tile("DR · parts delivered", summary.dr_rate, "parts"),
        _perception_tile(
            summary, "pose accuracy · poses right", "candidate_pose_accuracy", f"of {summary.candidates} candidates"
        ),
        _perception_tile(
            summary, "recall · parts found", "candidate_recall", f"of {summary.parts_to_find} half visible, all frames"
        ),
        tile("MPPH · picks per hour", number(summary.mpph, 0), f"95 %: {spread(mpph)} · {parts}"),
        tile("MPPH overlapped", number(summary.mpph_overlapped, 0), f"95 %: {spread(overlapped)} · {saved}"),
        tile("per hour of motion alone", number(summary.motion_dph, 0), f"95 %: {spread(motion)}"),
    ]
    return f"<div class='grid tiles'>{''.join(tiles)}</div>"


def _rate_tile(name: str, rate: Rate, of: str) -> str:
    interval = f"{100 * rate.low:.1f} to {100 * rate.high:.1f} %"
    bounds = None if rate.value is None else (rate.low, rate.high, rate.value)
    return tile(name, percent(rate.value), f"{rate.successes} of {rate.n} {of} · 95 %: {interval}", bounds)


def _perception(summary: Summary) -> str:
    """Return the numbers of perception on the same frames."""
    error = f"{fine(summary.pose_error['mm'])} mm, {fine(summary.pose_error['deg'])}°"
    given = _given_note(summary, "pose_error")
    tiles = [
        _perception_tile(
            summary, "AP · segmentation", "ap", f"AP50 {percent(summary.ap50)}, AP75 {percent(summary.ap75)}"
        ),
        _perception_tile(summary, "precision · of candidates", "candidate_precision", "each part once"),
        tile("pose errors · medians", GIVEN if given else error, f"{given} · {error}" if given else "at the centre"),
    ]
    stages = ", ".join(f"{name} {ms:.0f}" for name, ms in summary.perception_ms.items())
    note = f"{counted(summary.frames, 'frame')} that decisions were made on" + (
        f"; a frame's medians [ms]: {stages}" if stages else ""
    )
    if summary.frame_causes:
        note += f"; likely causes of lost parts: {escape(causes_text(summary.frame_causes, summary.frames))}"
    return f"<h2>Perception in the same bins</h2><p>{note}.</p><div class='grid tiles'>{''.join(tiles)}</div>"


def _perception_tile(summary: Summary, name: str, key: str, note: str) -> str:
    """Return a tile of a number of perception; one that the ground truth determined is labelled as given."""
    value, interval = getattr(summary, key), summary.intervals[key]
    if given := _given_note(summary, key):
        return tile(name, GIVEN, given if value is None else f"{given} · {percent(value)}, {note}")
    bounds = None if value is None or interval is None else (*interval, value)
    return tile(name, percent(value), f"{note}{_spread(interval)}", bounds)


def _given_note(summary: Summary, key: str) -> str:
    """Return why a number was not measured; "" if it was."""
    perception = summary.config["perception"]
    if key not in given_numbers(perception):
        return ""
    if perception == "gt_masks":
        return "not measured: true segments"
    noise = any(summary.config["pose_noise"].values())
    return f"not measured: true poses{' with noise' if noise else ''}"


def _spread(interval: Interval | None) -> str:
    return "" if interval is None else f" · 95 %: {100 * interval[0]:.1f} to {100 * interval[1]:.1f} %"


def _outcomes(summary: Summary) -> str:
    outcomes = [(n, c, "good" if n == GraspOutcome.DELIVERED else "bad") for n, c in summary.outcomes.items()]
    stages = [(f"{FAILED_AT}-{name}", count, "bad") for name, count in summary.failure_attribution.items()]
    pushes = [(name, count, "idle") for name, count in summary.pushes.items()]
    pushed = f"<h3>Pushes by outcome</h3>{linked_bars(pushes, sum(summary.pushes.values()))}"
    reasons = [(name, count, "idle") for name, count in summary.abstentions.items()]
    ends = [(name, count, "good" if name == "empty" else "idle") for name, count in summary.termination.items()]
    remaining = summary.parts_total - summary.delivered - summary.lost
    c = summary.clutter
    clutter = (
        f"Settled bins: median visible fraction {number(c['median'], 2)}, {percent(c['below_half'])} of "
        f"parts under 0.5 visible, {percent(c['above_nine_tenths'])} over 0.9."
    )
    fate = f"{summary.delivered} delivered, {summary.lost} lost (out of play undelivered), {remaining} left in the bin."
    left = (
        f"<div class='card'><h3>Attempts by outcome</h3>{linked_bars(outcomes, summary.attempts)}"
        f"<h3>Failed attempts by stage</h3>{linked_bars(stages, summary.failures)}</div>"
    )
    right = (
        f"<div class='card'><h3>Abstentions by reason</h3>{linked_bars(reasons, sum(summary.abstentions.values()))}"
        f"{pushed if sum(summary.pushes.values()) else ''}"
        f"<h3>Bins by their end</h3>{bars(ends, summary.bins)}<h3>Parts</h3><p>{fate}</p>"
        f"<h3>Clutter</h3><p>{clutter}</p></div>"
    )
    return f"<h2>Outcomes and causes</h2><div class='grid two'>{left}{right}</div>"


def _bin(record: BinRecord, pictures: PictureSource) -> str:
    facts = (
        f"seed {record.seed} · {record.delivered} of {record.parts_total} delivered, {record.lost} lost · "
        f"{_ENDS[record.termination]} · "
        f"median visibility {record.clutter.median:.2f} · {record.wall:.1f} s"
    )
    views = ""
    if record.before or record.after:
        remaining = record.parts_total - record.delivered - record.lost
        seen = ((record.before, "settled", record.parts_total), (record.after, "at the end", remaining))
        pair = [
            figure(pictures.source(name), when, f"bin {record.index} {when}: {parts} parts, seen from the tray's side")
            for name, when, parts in seen
        ]
        views = f"<div class='grid two'>{''.join(pair)}</div>"
    rows = [_row(k, pick) for k, pick in enumerate(record.picks)]
    attempts = f"<details><summary>{len(rows)} decisions</summary>{table(COLUMNS, rows, words=(1, 2))}</details>"
    head = f"<h3>Bin {record.index} <span>{facts}</span></h3>"
    return f"<div class='card bin'>{head}{views}{strip(record)}{undelivered_words(record)}{attempts}</div>"


def _row(k: int, pick: PickRecord) -> list[str]:
    def mm(length: float | None) -> str:
        return "–" if length is None else f"{1000 * length:.1f}"

    times = [f"{t:.2f}" for t in (pick.t_sense, pick.t_compute, pick.t_motion, pick.t_concurrent)]
    features = ", ".join(f"{name} {value:.3g}" for name, value in pick.features.items())
    score = f"<span title='{escape(features)}'>{number(pick.score, 2)}</span>"
    part = "–" if pick.part < 0 else str(pick.part)
    grasp = [part, mm(pick.width), mm(pick.opening), score]
    return [
        str(k),
        tag(title(pick), colour(pick)),
        str(pick.failure_attribution or "–"),
        *grasp,
        *times,
        str(pick.frame_id),
    ]


def _csv_link(records: Sequence[BinRecord]) -> str:
    data = base64.b64encode(picks_csv(records).encode()).decode()
    return f"<p><a download='picks.csv' href='data:text/csv;charset=utf-8;base64,{data}'>All decisions as CSV</a></p>"


def _settings(config: Mapping[str, Any]) -> str:
    """Return every setting of cell, camera and picker in one table."""
    cell = CellConfig()
    standard = {"bin": cell.bin.inner_size, "jaw": GRIPPER_STROKE, "friction": cell.contact.friction[0]}
    standard["max_acceleration"] = cell.robot.max_acceleration
    values = {name: standard.get(name) if value is None else value for name, value in config.items()}
    words = {name: _words(value, name in _RANGES) for name, value in flat_settings(values).items()}
    rows = [[escape(name), f"<code>{escape(value)}</code>"] for name, value in words.items()]
    note = "Lengths in m, angles in rad, times in s, unless a name says otherwise."
    shown = table(("setting", "value"), rows, words=(0, 1))
    return (
        f"<h2>The cell's settings</h2><div class='card'><p>{note}</p>"
        f"<details><summary>{len(rows)} settings</summary>{shown}</details></div>"
    )


def _words(value: Any, is_range: bool) -> str:
    """Return a setting as text, numbers with six digits."""
    if value is None:
        return "default"
    if isinstance(value, list | tuple):
        return (" to " if is_range else " x ").join(_words(each, is_range) for each in value)
    return f"{value:g}" if isinstance(value, float) else f"{value}"


def _provenance(summary: Summary) -> str:
    commits = ", ".join(commit or "not in a git checkout" for commit in summary.git_commits)
    rows = [["command", summary.command], ["commit", commits], *([k, v] for k, v in summary.versions.items())]
    cells = [[escape(name), f"<code>{escape(value)}</code>"] for name, value in rows]
    return f"<h2>How it was made</h2><div class='card'>{table(('what', 'value'), cells, words=(0, 1))}</div>"
