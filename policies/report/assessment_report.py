"""``report.html`` of an assessment: one page from what to do down to every decision, with its pictures inside."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

import cv2
import numpy as np

from binpick_env.evaluation.pose.pictures import pose_panels
from binpick_env.evaluation.pose.record import PoseRecord
from binpick_env.evaluation.pose.scene_score import worst_first
from binpick_env.evaluation.segmentation.record import record_path
from binpick_env.jobs.report_style import bars, inline_figure, page, table, tag, tile
from binpick_env.jobs.text_tables import counted, number, percent
from perception.geometry import Floats, rotation_about
from perception.part import PartModel
from perception.pose.model.appearances import edge_appearances
from perception.runtime.files import write_atomically
from policies.assessment.advice import Advice
from policies.assessment.assessment import Assessment
from policies.assessment.config import PICKS, SCENES
from policies.assessment.findings import Findings
from policies.assessment.resting import RestingPose
from policies.assessment.run import AssessmentRun
from policies.evaluation.budget import MODES, Budget
from policies.report.assessment_text import STAGES, finding_words, grip_words
from policies.report.bin_map import undelivered_section
from policies.report.budget_report import NOTE, cost_names, cost_rows, number_rows
from policies.report.contact_sheet import portrait
from policies.report.gallery import gallery_section
from policies.report.picture_source import PictureSource

PORTRAIT = 260  # side of a picture of a resting pose [px]
SHOWN_RESTS = 6  # largest number of resting poses that are shown
SHOWN_SCENES = 2  # number of scenes that are shown, the worst first
# From the floor's axes to those of a view from above at an angle: right, up, towards the eye.
_R_VIEW_FLOOR = rotation_about((1, 0, 0), np.deg2rad(-58)) @ rotation_about((0, 0, 1), np.deg2rad(38))
_LEGEND = (
    "The scenes with the lowest recall. Outlines are verified poses, green if they are right, red if they are wrong; "
    "amber: parts half visible or more that no right pose is of. A group has the colour of the part that it fits."
)


def write_assessment_report(path: Path, run: AssessmentRun, folder: Path) -> None:
    """Write the page in one piece, with its pictures inside.

    Args:
        path: Path of the HTML file.
        run: The assessment with its records.
        folder: Folder of the assessment, which holds the records of scenes and bins.

    Raises:
        RecordError: The record of a shown scene is missing or damaged.
    """
    assessment = run.assessment
    findings = assessment.findings
    name = escape(findings.part.name)
    sections = [
        f"<h1>Assessment: {name}</h1><p>{escape(_conditions(assessment))}</p>",
        _headline(findings),
        _advice(assessment.advice),
        _losses(findings),
        _facts(findings),
        _rests(findings, run.part.model),
        _scenes(run, folder / SCENES),
        _picks(run, path, folder / PICKS),
        _provenance(assessment),
    ]
    write_atomically(path, page(f"binpick: assessment of {findings.part.name}", "".join(sections)))


def _conditions(assessment: Assessment) -> str:
    findings = assessment.findings
    options, low, high = findings.options, *findings.bin.dropped
    size = " x ".join(f"{1000 * side:.0f}" for side in findings.bin.inner_size)
    parts = f"{low}" if low == high else f"{low} to {high}"
    facts = [f"bin {size} mm", f"{parts} parts", f"camera at {options.camera_distance:g} m", f"sensor {options.sensor}"]
    facts += [f"jaw up to {1000 * findings.grip.stroke:.0f} mm", f"seed {assessment.seed}"]
    return " · ".join(facts)


def _headline(findings: Findings) -> str:
    seen, picked = findings.perception, findings.picking
    tiles = []
    if seen is not None:
        for name, key, of in (
            ("AP · segmentation", "ap", f"{seen.weights}, {seen.training}"),
            ("recognition", "recognition", f"of {seen.trials} trials"),
            ("recall", "recall", f"of {seen.parts_to_find} parts half visible"),
            ("precision", "precision", f"of {seen.verified} verified poses"),
        ):
            value, (low, high) = getattr(seen, key), seen.intervals[key]
            known = not np.isnan([value, low, high]).any()
            spread = f"95 %: {100 * low:.1f} to {100 * high:.1f} % · " if known else ""
            bounds = (low, high, value) if known else None
            tiles.append(tile(name, percent(value) if known else "–", f"{spread}{of}", bounds))
    if picked is not None:
        tiles.append(tile("DR · parts delivered", percent(picked.dr["learned"]), f"of {picked.parts} parts"))
        mpph = f"{number(picked.mpph['learned'], 0)} picks per hour"
        tiles.append(tile("GSR · grasp success", percent(picked.gsr["learned"]), mpph))
    missing = [
        f"<p>{what} not run: {escape(reason)}.</p>"
        for what, reason in (("Perception was", findings.not_perceived), ("Picks were", findings.not_picked))
        if reason is not None
    ]
    return f"<div class='grid tiles'>{''.join(tiles)}</div>{''.join(missing)}"


def _advice(advice: Sequence[Advice]) -> str:
    if not advice:
        return "<h2>What to do</h2><p>Nothing was found that should be changed.</p>"
    cards = [
        f"<div class='card'><h3>{tag(piece.kind, 'idle')}</h3><p>{_with_commands(piece.text)}.</p>"
        f"<p>Because {escape(piece.because)}.</p></div>"
        for piece in advice
    ]
    return f"<h2>What to do</h2><div class='grid two'>{''.join(cards)}</div>"


def _with_commands(text: str) -> str:
    """Return a text in HTML whose commands are set as code."""
    words, found, command = text.partition(": binpick ")
    return f"{escape(words)}: <code>{escape('binpick ' + command)}</code>" if found else escape(text)


def _losses(findings: Findings) -> str:
    picked = findings.picking
    if picked is None:
        return ""
    shares = [("delivered", picked.losses.delivered, "good")]
    shares += [(f"lost by {words}", getattr(picked.losses, name), "bad") for name, words in STAGES.items()]
    rows = [(name, max(round(share * picked.parts), 0), kind) for name, share, kind in shares]
    note = (
        f"All {picked.parts} parts of {counted(picked.bins, 'bin')}, picked from pixels, with true segments and with "
        "true poses. "
        "A stage loses what its ground truth would deliver more; chance can make that negative, which is shown as 0."
    )
    return f"<h2>Where it is lost</h2><p>{note}</p><div class='card'>{bars(rows, picked.parts)}</div>"


def _facts(findings: Findings) -> str:
    rows = [[escape(name), escape(words)] for name, words in finding_words(findings)]
    part = findings.part
    rows[1:1] = [["source", escape(part.source)], ["mesh", f"{part.faces} faces, {1e6 * part.volume:.3g} cm³"]]
    rows.insert(3, ["density", f"{part.density:g} kg/m³"])
    return f"<h2>What was measured</h2><div class='card'>{table(('what', 'result'), rows, words=(0, 1))}</div>"


def _rests(findings: Findings, model: PartModel) -> str:
    poses = list(zip(findings.rests, findings.grip.at_rest, strict=True))[:SHOWN_RESTS]
    figures = [_rest(rest, count, model) for rest, count in poses]
    note = (
        "Shares of drops on a floor, alone; poses that symmetry makes equal are one. A grasp counts if it is within "
        "50° of straight down and touches neither floor nor part on its way."
    )
    words = escape(grip_words(findings.grip))
    return (
        f"<h2>How it rests and is held</h2><p>{note}</p><p>Grasps: {words}.</p>"
        f"<div class='grid gallery'>{''.join(figures)}</div>"
    )


def _rest(rest: RestingPose, count: int, model: PartModel) -> str:
    R: Floats = _R_VIEW_FLOOR @ rest.T_floor_part(model)[:3, :3]
    coded, data = cv2.imencode(".png", portrait(model.mesh, R, PORTRAIT))
    if not coded:
        raise RuntimeError("OpenCV could not encode the picture of a resting pose")
    share = f"{100 * rest.share:.0f} %"
    caption = f"{share} of drops, {1000 * rest.height:.0f} mm high, {count or 'no'} grasps off the floor"
    alt = f"{model.name} at rest, seen from above at an angle: {caption}"
    return inline_figure(data.tobytes(), "png", caption, alt)


def _scenes(run: AssessmentRun, folder: Path) -> str:
    if not run.scores:
        return ""
    edges = edge_appearances(run.part.model)
    shown = []
    for score in worst_first(run.scores)[:SHOWN_SCENES]:
        record = PoseRecord.load(record_path(folder, score.index))
        facts = f"{(score.verified.found & score.to_find).sum()} of {score.to_find.sum()} parts found"
        figures = "".join(
            inline_figure(panel.data, panel.kind, panel.name, f"scene {score.index}, {facts}: {panel.name}")
            for panel in pose_panels(record, score, edges)
        )
        head = f"<h3>Scene {score.index} <span>{facts}</span></h3>"
        shown.append(f"<div class='card bin'>{head}<div class='grid four'>{figures}</div></div>")
    return f"<h2>How it is seen</h2><p>{_LEGEND}</p>{''.join(shown)}"


def _picks(run: AssessmentRun, path: Path, folder: Path) -> str:
    budget = run.assessment.budget
    if budget is None:
        return ""
    records = run.records["learned"]
    source = PictureSource(folder / "learned", path)
    gallery = gallery_section(records, source)
    return _budget(budget) + undelivered_section(records, budget.modes["learned"].config) + gallery


def _budget(budget: Budget) -> str:
    rows = [[escape(cell) for cell in row] for row in number_rows(budget)]
    costs = [[escape(cell) for cell in row] for row in cost_rows(budget)]
    return (
        f"<h2>The same bins three ways</h2><div class='card'>{table(('', *MODES), rows)}</div>"
        f"<h2>What each stage costs</h2><p>{NOTE}</p><div class='card'>{table(('', *cost_names()), costs)}</div>"
    )


def _provenance(assessment: Assessment) -> str:
    seconds = assessment.seconds
    rows = [[f"time: {name}", f"{value:.1f} s"] for name, value in seconds.items()]
    rows += [["time: together", f"{sum(seconds.values()):.1f} s"], ["command", assessment.command]]
    rows += [
        ["commit", assessment.git_commit or "not in a git checkout"],
        *([k, v] for k, v in assessment.versions.items()),
    ]
    cells = [[escape(name), f"<code>{escape(value)}</code>"] for name, value in rows]
    return f"<h2>How it was made</h2><div class='card'>{table(('what', 'value'), cells, words=(0, 1))}</div>"
