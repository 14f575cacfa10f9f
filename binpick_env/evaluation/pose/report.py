"""``report.html`` of an evaluation of poses: numbers, reliability of the scores, and scenes, the worst first."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from binpick_env.evaluation.pose.pictures import pose_panels
from binpick_env.evaluation.pose.record import PoseRecord
from binpick_env.evaluation.pose.scene_score import PoseSceneScore, worst_first
from binpick_env.evaluation.pose.summary import PoseSummary
from binpick_env.evaluation.pose.table import (
    band_rows,
    facts_line,
    headline_rows,
    milliseconds,
    perception_name,
    quantiles,
    reliability_rows,
)
from binpick_env.evaluation.segmentation.record import record_path
from binpick_env.evaluation.segmentation.table import bounds, share
from binpick_env.jobs.report_style import curves, inline_figure, page, table, tile
from binpick_env.jobs.text_tables import number, percent
from perception.pose.model.appearances import SeenEdges
from perception.runtime.files import write_atomically

_LEGEND = (
    "Scenes in the order of their own recall, the worst first. Outlines on the image are verified poses: green if they "
    "are right, red if they are wrong or a second pose of the same part. Amber: parts visible to a half or more that "
    "no right pose is of, as they truly lie. A group has the colour of the part that it fits with an IoU over 0.5; one "
    "that fits no part is striped red and white."
)


def write_pose_report(
    path: Path, summary: PoseSummary, scores: Sequence[PoseSceneScore], folder: Path, edges: SeenEdges, gallery: int
) -> None:
    """Write the report atomically, with its pictures inside.

    Args:
        path: HTML file.
        summary: Summary of the evaluation.
        scores: Score of each scene.
        folder: Folder of the scenes' records.
        edges: Edges of the part that are visible from each direction, drawn as the outlines of poses.
        gallery: Largest number of scenes to show.

    Raises:
        RecordError: The record of a shown scene is missing or damaged.
    """
    part = Path(summary.part).name
    sections = [
        f"<h1>Poses: {escape(part)}</h1><p>{escape(facts_line(summary))}</p><p>{escape(summary.note)}</p>",
        _headline(summary),
        _scores(summary),
        _parts(summary),
        _gallery(scores, folder, edges, gallery),
        _provenance(summary),
    ]
    write_atomically(path, page(f"binpick: {part}", "".join(sections), wide=True))


def _headline(summary: PoseSummary) -> str:
    tiles = []
    for name, value, of, (low, high) in headline_rows(summary):
        track = None if np.isnan(value) or np.isnan(low) else (low, high, value)
        tiles.append(tile(name.capitalize(), share(value), f"95 %: {bounds((low, high))} · {of}", track))
    ms = summary.ms
    threads = "/".join(map(str, summary.threads))
    stages = f"boundary {milliseconds(ms['boundary'])}, segmentation {milliseconds(summary.ms_segmentation)}"
    note = f"{stages}, poses {milliseconds(summary.ms_pose)} · threads: {threads}"
    tiles.append(tile("ms a scene", milliseconds(ms["total"]), note))
    return f"<div class='grid tiles'>{''.join(tiles)}</div>"


def _scores(summary: PoseSummary) -> str:
    filled = [each for each in summary.reliability if each.poses]
    lines = [
        ("if scores were probabilities", [(0.0, 0.0), (1.0, 1.0)]),
        ("share that is right", [(each.mean_score, each.share) for each in filled]),
    ]
    words = (
        "Every pose, verified or not, by its score; right is a pose that fits some part, be it a second one of the "
        f"same. Mean difference between score and share {share(summary.calibration_error)} %. A pose is verified from "
        f"{summary.min_score:g}."
    )
    header, *rows = reliability_rows(summary)
    left = f"<div class='card'><h3>What a score is worth</h3>{curves(lines, 'score', 'share right')}</div>"
    right = f"<div class='card'><h3>By score</h3>{table(header, rows)}<p>{words}</p></div>"
    return f"<h2>Scores</h2><div class='grid two'>{left}{right}</div>"


def _parts(summary: PoseSummary) -> str:
    c = summary.clutter
    bands = [band for band in summary.by_visible_fraction if band.parts]
    lines = [("recall", [((band.low + band.high) / 2, band.recall) for band in bands])]
    words = (
        f"Visible fraction: median {number(c['median'], 2)}, {percent(c['below_half'])} of parts under 0.5, "
        f"{percent(c['above_nine_tenths'])} over 0.9. Errors of recognised trials: "
        f"{quantiles(summary.translation_mm, 'mm')}; {quantiles(summary.rotation_deg, 'deg')}. Segments have an AP of "
        f"{share(summary.ap)}, and of {share(summary.explained['ap'])} once the poses have explained the points."
    )
    header, *rows = band_rows(summary)
    left = f"<div class='card'><h3>Recall</h3>{curves(lines, 'visible fraction', 'recall')}</div>"
    right = f"<div class='card'><h3>By visible fraction</h3>{table(header, rows)}<p>{words}</p></div>"
    return f"<h2>Parts</h2><div class='grid two'>{left}{right}</div>"


def _gallery(scores: Sequence[PoseSceneScore], folder: Path, edges: SeenEdges, limit: int) -> str:
    shown = worst_first(scores)[:limit]
    more = f" {len(shown)} of {len(scores)} scenes." if len(shown) < len(scores) else ""
    return f"<h2>Scenes</h2><p>{_LEGEND}{more}</p>" + "".join(_scene(score, folder, edges) for score in shown)


def _scene(score: PoseSceneScore, folder: Path, edges: SeenEdges) -> str:
    record = PoseRecord.load(record_path(folder, score.index))
    given, trials = score.verified, score.trials.recognised
    facts = (
        f"{(given.found & score.to_find).sum()} of {score.to_find.sum()} parts found · {(~given.correct).sum()} of "
        f"{len(given.correct)} verified poses wrong · {trials.sum()} of {len(trials)} trials recognised · "
        f"{score.groups} groups · {milliseconds(score.ms['total'])} ms"
    )
    figures = "".join(
        inline_figure(panel.data, panel.kind, panel.name, f"scene {score.index}: {panel.name}")
        for panel in pose_panels(record, score, edges)
    )
    return (
        f"<div class='card bin'><h3>Scene {score.index} <span>{facts}</span></h3>"
        f"<div class='grid four'>{figures}</div></div>"
    )


def _provenance(summary: PoseSummary) -> str:
    commits = ", ".join(commit or "not in a git checkout" for commit in summary.git_commits)
    weights = [[f"weights: {k}", str(v)] for k, v in (summary.weights or {}).items()]
    estimator = [[f"estimator: {k}", str(v)] for k, v in summary.config["method"]["estimator"].items()]
    rows = [["command", summary.command], ["commit", commits], ["segments", perception_name(summary)], *weights]
    rows += estimator + [[k, v] for k, v in summary.versions.items()]
    cells = [[escape(name), f"<code>{escape(value)}</code>"] for name, value in rows]
    return f"<h2>How it was made</h2><div class='card'>{table(('what', 'value'), cells, words=(0, 1))}</div>"
