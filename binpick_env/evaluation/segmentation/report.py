"""``report.html`` of an evaluation of segmentation: numbers, precision-recall curves, and scenes, the worst first."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from binpick_env.evaluation.segmentation.pictures import scene_panels
from binpick_env.evaluation.segmentation.record import SceneRecord, record_path
from binpick_env.evaluation.segmentation.summary import SceneScore, SegmentationSummary
from binpick_env.evaluation.segmentation.table import METRICS, band_rows, bounds, method_name, share
from binpick_env.jobs.report_style import curves, inline_figure, page, table, tile
from binpick_env.jobs.text_tables import counted, number, percent
from perception.metrics.average_precision import precision_recall
from perception.runtime.files import write_atomically

CURVE_POINTS = 400  # largest number of points that a curve is drawn with
_LEGEND = (
    "Scenes in the order of their own AP, the worst first. A prediction has the colour of the part that it fits with "
    "an IoU over 0.5; one that fits no part is striped red and white. Grey: the container, parts under 0.1 visible, "
    "and points without a label."
)


def write_report(
    path: Path, summary: SegmentationSummary, scores: Sequence[SceneScore], folder: Path, gallery: int
) -> None:
    """Write the report atomically, with its pictures inside.

    Args:
        path: HTML file.
        summary: Summary of the evaluation.
        scores: Score of each scene.
        folder: Folder of the scenes' records.
        gallery: Largest number of scenes to show.

    Raises:
        RecordError: The record of a shown scene is missing or damaged.
    """
    part = Path(summary.part).name
    facts = (
        f"{counted(summary.scenes, 'scene')} · {method_name(summary)} · sensor {summary.sensor} · seed {summary.seed}"
    )
    sections = [
        f"<h1>Segmentation: {escape(part)}</h1><p>{escape(facts)}</p><p>{escape(summary.note)}</p>",
        _headline(summary),
        _curves_and_bands(summary, scores),
        _gallery(scores, folder, gallery),
        _provenance(summary),
    ]
    write_atomically(path, page(f"binpick: {part}", "".join(sections), wide=True))


def worst_first(scores: Sequence[SceneScore]) -> list[SceneScore]:
    """Sort scenes by ascending AP; those without a part to find come last."""
    return sorted(scores, key=lambda score: (bool(np.isnan(score.ap)), score.ap, score.index))


def _headline(summary: SegmentationSummary) -> str:
    tiles = []
    for name in METRICS:
        value, (low, high) = getattr(summary, name), summary.intervals[name]
        track = None if np.isnan(value) or np.isnan(low) else (low, high, value)
        tiles.append(tile(name.upper(), share(value), f"95 %: {bounds((low, high))}", track))
    ms = summary.ms
    stages = ", ".join(f"{name} {ms[name]:.0f}" for name in ("boundary", "surface", "segmentation"))
    threads = "/".join(map(str, summary.threads))
    tiles.append(tile("ms a scene", f"{summary.ms_per_scene:.0f}", f"{stages} · threads: {threads}"))
    return f"<div class='grid tiles'>{''.join(tiles)}</div>"


def _curves_and_bands(summary: SegmentationSummary, scores: Sequence[SceneScore]) -> str:
    lines = []
    for overlap in (0.5, 0.75):
        curve = precision_recall([score.matches for score in scores], overlap)
        if not np.isnan(curve.recall).any():
            some = np.unique(np.linspace(0, len(curve.recall) - 1, CURVE_POINTS).astype(int))
            points = list(zip(curve.recall[some].tolist(), curve.precision[some].tolist(), strict=True))
            lines.append((f"IoU {overlap}", points))
    c = summary.clutter
    clutter = (
        f"Visible fraction: median {number(c['median'], 2)}, {percent(c['below_half'])} of parts under 0.5, "
        f"{percent(c['above_nine_tenths'])} over 0.9. {summary.points_per_scene:.0f} boundary points a scene, all of "
        "them labelled and scored. In a band's row the parts outside it are neither right nor wrong, but predictions "
        "that fit no part at all are wrong in every row; the last two columns are the shares of its parts that some "
        "prediction fits."
    )
    header, *rows = band_rows(summary)
    left = f"<div class='card'><h3>Precision and recall</h3>{curves(lines, 'recall', 'precision')}</div>"
    right = f"<div class='card'><h3>By visible fraction</h3>{table(header, rows)}<p>{clutter}</p></div>"
    return f"<h2>Where it is won and lost</h2><div class='grid two'>{left}{right}</div>"


def _gallery(scores: Sequence[SceneScore], folder: Path, limit: int) -> str:
    shown = worst_first(scores)[:limit]
    more = f" {len(shown)} of {len(scores)} scenes." if len(shown) < len(scores) else ""
    return f"<h2>Scenes</h2><p>{_LEGEND}{more}</p>" + "".join(_scene(score, folder) for score in shown)


def _scene(score: SceneScore, folder: Path) -> str:
    record = SceneRecord.load(record_path(folder, score.index))
    wanted = sum(score.matches.truth_counts.values())
    at_half = score.matches.overlap_idx == score.matches.overlaps.index(0.5)
    right = int((at_half & score.matches.correct).sum())
    wrong = int((at_half & ~score.matches.correct).sum())
    facts = (
        f"AP {share(score.ap)} · {right} of {wanted} parts found, {wrong} wrong predictions at IoU 0.5 · "
        f"{score.points} points · {score.ms['total']:.0f} ms"
    )
    figures = "".join(
        inline_figure(panel.data, panel.kind, panel.name, f"scene {score.index}: {panel.name}")
        for panel in scene_panels(record)
    )
    return (
        f"<div class='card bin'><h3>Scene {score.index} <span>{facts}</span></h3>"
        f"<div class='grid four'>{figures}</div></div>"
    )


def _provenance(summary: SegmentationSummary) -> str:
    commits = ", ".join(commit or "not in a git checkout" for commit in summary.git_commits)
    weights = [[f"weights: {k}", str(v)] for k, v in (summary.weights or {}).items()]
    method = [[k, str(v)] for k, v in summary.method.items() if k != "weights"]
    rows = [["command", summary.command], ["commit", commits], *weights, *method]
    rows += [[k, v] for k, v in summary.versions.items()]
    cells = [[escape(name), f"<code>{escape(value)}</code>"] for name, value in rows]
    return f"<h2>How it was made</h2><div class='card'>{table(('what', 'value'), cells, words=(0, 1))}</div>"
