"""Map of a bin from above: where parts were lost or left, and why."""

from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from binpick_env.config import BinConfig
from binpick_env.jobs.report_style import bars
from binpick_env.jobs.text_tables import percent
from policies.evaluation.records import BinRecord
from policies.evaluation.undelivered import LeftReason, UndeliveredPart

_MARGIN = 26  # width of the margin around the bin [mm]
_CSS = """
.map rect { fill: var(--track); stroke: var(--soft); stroke-width: 2; } .map { max-width: 560px; }
.map .left { fill: var(--idle); stroke: var(--card); stroke-width: 1; }
.map .lost { stroke: var(--bad); stroke-width: 4; fill: none; }
"""
_REASONS = {
    None: "reason not recorded",
    LeftReason.NO_CANDIDATE: "no candidate of it",
    LeftReason.NO_CLEAR_APPROACH: "no clear approach",
    LeftReason.IK_INFEASIBLE: "out of the arm's reach",
    LeftReason.NOT_TRIED: "not tried, the bin had ended",
}
NOTE = (
    "Every part that was not delivered, all bins on top of each other, from above; the bin's frame, in mm. A circle is "
    "a part that was left, where it lay at the end; a cross is a part that was lost, where it last lay in the bin. "
    "Pointing at a mark tells bin, part and reason."
)


def undelivered_section(records: Sequence[BinRecord], config: Mapping[str, Any]) -> str:
    """Return the section of the page on lost and left parts.

    Args:
        records: Records of all bins, in order.
        config: Settings of the evaluation, by name.
    """
    title = "<h2>Parts lost or left</h2>"
    old = [record.index for record in records if record.undelivered is None]
    note = f"<p>Not recorded by the version that picked bins {', '.join(map(str, old))}.</p>" if old else ""
    parts = [(record.index, part) for record in records for part in record.undelivered or ()]
    if not parts:
        return f"{title}{note}" + ("" if old else "<p>None: every part was delivered.</p>")
    left = [part for _, part in parts if part.lost is None]
    lost = [part for _, part in parts if part.lost is not None]
    reasons = Counter(_REASONS[part.reason] for part in left)
    ways = Counter(str(part.lost).replace("_", " ") for part in lost)
    counts = (
        f"<h3>Left, by what the picker made of them in the last frame</h3>"
        f"{bars([(name, n, 'idle') for name, n in reasons.most_common()], len(left))}"
        f"<h3>Lost, by how</h3>{bars([(name, n, 'bad') for name, n in ways.most_common()], len(lost))}"
    )
    drawn = _map(parts, config["bin"] or BinConfig().inner_size)
    return (
        f"<style>{_CSS}</style>{title}{note}<p>{NOTE}</p>"
        f"<div class='grid two'><div class='card'>{drawn}</div><div class='card'>{counts}</div></div>"
    )


def undelivered_words(record: BinRecord) -> str:
    """Return a bin's lost and left parts as one line of HTML; "" without any."""
    words = "; ".join(_words(part) for part in record.undelivered or ())
    return f"<p>Not delivered: {escape(words)}.</p>" if words else ""


def _words(part: UndeliveredPart) -> str:
    visible = f"{percent(part.visible_fraction)} visible"
    if part.lost is not None:
        return f"part {part.part} lost in decision {part.decision} ({str(part.lost).replace('_', ' ')})"
    pose = ", pose wrong" if part.pose_correct is False else ""
    return f"part {part.part} left ({_REASONS[part.reason]}{pose}, {visible})"


def _map(parts: Sequence[tuple[int, UndeliveredPart]], size: Sequence[float]) -> str:
    """Return the map as SVG, whose unit is a millimetre."""
    length, width = (1000 * side for side in size[:2])
    drawn = [f"<rect x='0' y='0' width='{length:.0f}' height='{width:.0f}' rx='4'/>"]
    for index, part in parts:
        x, y = 1000 * part.position[0] + length / 2, width / 2 - 1000 * part.position[1]
        shape = f"<circle class='left' cx='{x:.1f}' cy='{y:.1f}' r='7'/>"
        if part.lost is not None:
            shape = f"<path class='lost' d='M{x - 6:.1f} {y - 6:.1f}l12 12m0 -12l-12 12'/>"
        drawn.append(f"<g>{shape}<title>bin {index}: {escape(_words(part))}</title></g>")
    drawn += [
        f"<text x='{at + length / 2:.0f}' y='{width + 18:.0f}' text-anchor='middle'>{at:.0f}</text>"
        for at in (-length / 2, 0.0, length / 2)
    ]
    drawn += [
        f"<text x='-6' y='{width / 2 - at + 4:.0f}' text-anchor='end'>{at:.0f}</text>"
        for at in (-width / 2, 0.0, width / 2)
    ]
    left = sum(part.lost is None for _, part in parts)
    label = f"Map of the bin from above: {left} parts left, {len(parts) - left} lost"
    box = f"{-_MARGIN - 12} {-6} {length + 2 * _MARGIN + 12:.0f} {width + _MARGIN + 6:.0f}"
    return f"<svg class='map' role='img' aria-label='{label}' viewBox='{box}'>{''.join(drawn)}</svg>"
