"""Pictures of every decision of an evaluation, failures first, with links that show one kind alone.

A link to ``#only-KIND`` hides all other decisions by the CSS selector ``:target``: the page needs no script.
"""

from collections.abc import Sequence
from html import escape

import numpy as np

from binpick_env.jobs.report_style import figure, tag
from binpick_env.jobs.text_tables import counted, fine, number, percent
from policies.evaluation.frame_record import CandidateRecord
from policies.evaluation.records import BinRecord, PickRecord
from policies.grasping.outcomes import GraspOutcome
from policies.report.picture_source import PictureSource

ALL = "all"
FAILED_AT = "failed-at"  # prefix of the kinds of attempts that failed at one stage
NOTE = (
    "The frame that each decision was made on. Boundary points have the colour of the part that their segment matches; "
    "red and white stripes: no part. The outline is that of the chosen candidate, green if its pose is correct and red "
    "if it is wrong. Orange: the fingertips open (thin) and closed (thick); white: the last 5 cm of the approach. An "
    "abstention's picture shows the whole bin with all candidates. A click enlarges a picture."
)
_CSS = """
.picks figure { scroll-margin: 12px; } .picks img { aspect-ratio: 1; background: var(--track); }
.picks { grid-template-columns: repeat(auto-fill, minmax(min(240px, 100%), 1fr)); }
.picks figure:target { outline: 3px solid var(--accent); outline-offset: 4px; border-radius: 8px; }
.filters a, .bar a, .strip a { color: inherit; } .filters { margin: 8px 0 14px; }
.filters a { margin-right: 12px; white-space: nowrap; }
.strip a { display: block; width: 15px; height: 15px; border-radius: 4px; }
"""


def gallery_section(records: Sequence[BinRecord], pictures: PictureSource) -> str:
    """Return the section of the page that shows every decision.

    Args:
        records: Records of all bins, in order.
        pictures: Sources of the pictures by their file names.
    """
    picks = [(record, k, pick) for record in records for k, pick in enumerate(record.picks)]
    picks.sort(key=lambda each: _rank(each[2]))
    counts = {ALL: len(picks)}
    for _, _, pick in picks:
        for kind in kinds(pick):
            counts[kind] = counts.get(kind, 0) + 1
    style = _CSS + "".join(
        f"#only-{kind}:target ~ .picks > figure:not(.is-{kind}) {{ display: none; }}\n"
        f"#only-{kind}:target ~ .filters a[href='#only-{kind}'] {{ font-weight: 700; }}\n"
        for kind in counts
        if kind != ALL
    )
    targets = "".join(f"<i id='only-{kind}'></i>" for kind in counts)
    links = " ".join(f"<a href='#only-{kind}'>{escape(words(kind))} ({count})</a>" for kind, count in counts.items())
    figures = "".join(_figure(record, k, pick, pictures) for record, k, pick in picks)
    return (
        f"<style>{style}</style>{targets}<h2>Picks</h2><p>{NOTE}</p><p class='filters'>{links}</p>"
        f"<div class='grid gallery picks'>{figures}</div>"
    )


def kinds(pick: PickRecord) -> list[str]:
    """Return the kinds that a decision belongs to: its outcome or its reason for abstention, and how it failed."""
    names = [str(pick.ending)]
    if pick.outcome is not None and not delivered(pick):
        names.append("failed")
    if pick.failure_attribution is not None:
        names.append(f"{FAILED_AT}-{pick.failure_attribution}")
    return names


def linked_bars(rows: Sequence[tuple[str, int, str]], total: int) -> str:
    """Return horizontal bars that are linked to the decisions they count.

    Args:
        rows: (kind of decision, number of them, CSS class) of each bar.
        total: Number that a bar of full length stands for.
    """
    lines = []
    for kind, count, colour in rows:
        share = count / total if total else 0.0
        name = escape(words(kind).removeprefix(words(FAILED_AT)).strip())
        linked = f"<a href='#only-{kind}'>{name}</a>" if count else f"<span style='text-align:left'>{name}</span>"
        fill = f"<div><i class='{colour}' style='width:{100 * share:.1f}%'></i></div>"
        lines.append(f"<div class='bar'>{linked}{fill}<span>{count} · {100 * share:.1f} %</span></div>")
    return "".join(lines) or "<p>none</p>"


def strip(record: BinRecord) -> str:
    """Return a bin's decisions as a row of coloured squares that are linked to their pictures."""
    squares = [
        f"<a class='{colour(pick)}' href='#{_anchor(record, k)}' title='{k}: {escape(title(pick))}'></a>"
        for k, pick in enumerate(record.picks)
    ]
    return f"<div class='strip'>{''.join(squares)}</div>"


def delivered(pick: PickRecord) -> bool:
    """Return whether an attempt delivered exactly one part."""
    return pick.outcome is GraspOutcome.DELIVERED


def colour(pick: PickRecord) -> str:
    """Return the CSS class of a decision: good for a delivery, bad for a failure, idle for an abstention."""
    return "idle" if pick.outcome is None else "good" if delivered(pick) else "bad"


def title(pick: PickRecord) -> str:
    """Return how a decision ended, in words."""
    return words(str(pick.ending))


def words(kind: str) -> str:
    """Return the name of a kind in words."""
    return kind.replace("_", " ").replace("-", " ")


def _rank(pick: PickRecord) -> int:
    """Order failures before abstentions before deliveries."""
    return ("bad", "idle", "good").index(colour(pick))


def _anchor(record: BinRecord, k: int) -> str:
    return f"bin-{record.index}-pick-{k}"


def _figure(record: BinRecord, k: int, pick: PickRecord, pictures: PictureSource) -> str:
    classes = " ".join(f"is-{kind}" for kind in kinds(pick))
    stage = "" if pick.failure_attribution is None else " " + tag(f"failed at {pick.failure_attribution}", "idle")
    caption = f"{tag(title(pick), colour(pick))}{stage} bin {record.index}, decision {k}{_facts(record, pick)}"
    shown = figure(pictures.source(pick.picture), caption, _alt(record, k, pick))
    return shown.replace("<figure>", f"<figure id='{_anchor(record, k)}' class='{classes}'>", 1)


def _alt(record: BinRecord, k: int, pick: PickRecord) -> str:
    """Return what a decision's picture shows, in words."""
    of = f"bin {record.index}, decision {k}"
    if pick.outcome is None:
        return f"{of}: the whole bin from above with all candidates; no attempt, {title(pick)}"
    candidate = record.candidate(pick)
    pose = (
        "" if candidate is None else f", {'correct' if candidate.right else 'wrong'} pose, {candidate_words(candidate)}"
    )
    return f"{of}: the grasp from above, with the jaw and the outline of the pose{pose}; {title(pick)}"


def _facts(record: BinRecord, pick: PickRecord) -> str:
    candidate = record.candidate(pick)
    if candidate is None:
        frame = record.frame(pick.frame_id)
        return "" if frame is None else f", {counted(len(frame.candidates), 'candidate')}"
    return f"<br>{escape(candidate_words(candidate))}"


def candidate_words(candidate: CandidateRecord) -> str:
    """Return a candidate's part, score, pose errors and the IoU of its segment, in words."""
    part = "no part" if candidate.part < 0 else f"part {candidate.part}"
    facts = [part, f"score {number(candidate.score, 2)}"]
    if candidate.translation is not None and candidate.rotation is not None:
        facts.append(f"off by {fine(1000 * candidate.translation)} mm, {fine(float(np.degrees(candidate.rotation)))}°")
    if candidate.overlap is not None:
        facts.append(f"segment IoU {percent(candidate.overlap)}")
    return ", ".join(facts)
