"""Ablation of the segmentation as plain text."""

import textwrap
from collections.abc import Sequence

from binpick_env.evaluation.segmentation.ablation_summary import AblationTable, RowResult
from binpick_env.evaluation.segmentation.table import bounds, share
from binpick_env.jobs.text_tables import columns, counted

_WIDE = 100  # width of the table [characters]


def segmentation_ablation_table(table: AblationTable) -> str:
    """Return the table that an ablation prints."""
    config = table.config
    title = (
        f"{config['part']} · sensor {config['sensor']} · {counted(table.scenes, 'scene')} · seed {config['seed']} · "
        f"{table.trainings} trainings of {config['steps']} steps"
    )
    lines = [title, "═" * _WIDE, columns(_rows(table.rows)), "─" * _WIDE, columns(_gains(table.rows)), "─" * _WIDE]
    lines += [columns(_facts(table.rows)), "─" * _WIDE]
    what = (
        "Means over trainings; intervals are 95 %, over trainings and scenes. Thresholds (in the embedding) and the "
        "Euclidean radius were chosen by AP on validation scenes, for each training. From SGPN to the distance mask "
        "GroupMerging groups one random subset, whose labels every other point takes from its nearest neighbour; the "
        "last two rows group all points."
    )
    lines += textwrap.wrap(f"NOTE  {what}", _WIDE) + textwrap.wrap(f"NOTE  {table.note}", _WIDE)
    return "\n".join(lines)


def _rows(rows: Sequence[RowResult]) -> list[tuple[str, ...]]:
    lines: list[tuple[str, ...]] = [("", "AP50", "95 %", "AP75", "95 %", "AP", "paper: AP50", "AP75")]
    for row in rows:
        paper = [share(row.paper[name]) if row.paper else "–" for name in ("ap50", "ap75")]
        i = row.intervals
        values = (share(row.ap50), bounds(i["ap50"]), share(row.ap75), bounds(i["ap75"]), share(row.ap))
        lines.append((row.name, *values, *paper))
    return lines


def _gains(rows: Sequence[RowResult]) -> list[tuple[str, ...]]:
    lines: list[tuple[str, ...]] = [("against the row above", "AP50", "95 %", "AP75", "95 %")]
    for row in rows:
        if row.gain is not None:
            cells = [f(row.gain[name]) for name in ("ap50", "ap75") for f in (_value, _ends)]
            lines.append((row.name, *cells))
    return lines


def _facts(rows: Sequence[RowResult]) -> list[tuple[str, ...]]:
    lines: list[tuple[str, ...]] = [("", "chosen", "AP50 of each", "AP75 of each", "minutes", "ms a scene")]
    for row in rows:
        unit = 1000.0 if row.minutes[0] is None else 1.0
        chosen = " ".join(f"{unit * value:g}" for value in row.chosen) + (" mm" if unit > 1 else "")
        each = [" ".join(share(one[name]) for one in row.each) for name in ("ap50", "ap75")]
        minutes = " ".join("–" if m is None else f"{m:.1f}" for m in row.minutes)
        lines.append((row.name, chosen, *each, minutes, f"{row.ms_per_scene:.0f}"))
    return lines


def _value(gain: tuple[float, float, float]) -> str:
    return f"{100 * gain[0]:+.1f}"


def _ends(gain: tuple[float, float, float]) -> str:
    return f"{100 * gain[1]:+.1f} to {100 * gain[2]:+.1f}"
