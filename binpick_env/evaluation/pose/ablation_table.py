"""Ablation of the pose estimation as plain text."""

import textwrap
from collections.abc import Sequence

import numpy as np

from binpick_env.evaluation.pose.ablation import METRICS, PoseAblation, PoseRowResult
from binpick_env.evaluation.pose.table import milliseconds
from binpick_env.evaluation.segmentation.table import bounds, share
from binpick_env.jobs.text_tables import columns, counted

_WIDE = 112  # width of the table [characters]
_NOTE = (
    "All rows are evaluated on the same scenes, all but the last with true segments. Recognition counts the pose of "
    "the three groups of a scene nearest to a whole part, verified or not; without segments the trials are the same "
    "parts, found if any verified pose is correct for them. Intervals are 95 %: Wilson for recognition and precision, "
    "bootstrap over scenes for recall and for differences."
)


def pose_ablation_table(table: PoseAblation) -> str:
    """Return the table that an ablation prints."""
    threads = " or ".join(map(str, table.threads))
    title = (
        f"{table.part} · sensor {table.sensor} · {counted(table.scenes, 'scene')} · seed {table.seed} · "
        f"{table.rows[0].trials} trials · threads: {threads}"
    )
    lines = [title, "═" * _WIDE, columns(_rows(table.rows)), "─" * _WIDE, columns(_differences(table.rows))]
    return "\n".join([*lines, "─" * _WIDE, *textwrap.wrap(f"NOTE  {_NOTE}", _WIDE)])


def _rows(rows: Sequence[PoseRowResult]) -> list[tuple[str, ...]]:
    lines: list[tuple[str, ...]] = [
        ("", "recognised", "95 %", "recall", "95 %", "precision", "95 %", "poses", "ms a group", "ms a scene")
    ]
    for row in rows:
        shares = [cell for name in METRICS for cell in (share(getattr(row, name)), bounds(row.intervals[name]))]
        times = (milliseconds(row.ms_per_group), milliseconds(row.ms_pose))
        lines.append((row.name, *shares, str(row.delivered), *times))
    return lines


def _differences(rows: Sequence[PoseRowResult]) -> list[tuple[str, ...]]:
    lines: list[tuple[str, ...]] = [
        ("against the first row", "recognised", "95 %", "recall", "95 %", "precision", "95 %")
    ]
    for row in rows:
        if row.against_full is not None:
            cells = [cell for name in METRICS for cell in _difference(row.against_full[name])]
            lines.append((row.name, *cells))
    return lines


def _difference(values: tuple[float, float, float]) -> tuple[str, str]:
    if np.isnan(values).any():
        return "–", "–"
    return f"{100 * values[0]:+.1f}", f"{100 * values[1]:+.1f} to {100 * values[2]:+.1f}"
