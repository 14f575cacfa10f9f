"""An assessment as a dozen lines for the terminal, which end with the advice."""

from collections.abc import Sequence
from pathlib import Path

from binpick_env.jobs.text_tables import counted, number, percent
from policies.assessment.assessment import Assessment
from policies.assessment.findings import Findings
from policies.assessment.grip import GripFacts
from policies.assessment.part import PartFacts
from policies.assessment.perception import PerceptionFacts
from policies.assessment.picking import PickingFacts
from policies.evaluation.budget import MODES

_LABEL = 11  # width of the labels [characters]
STAGES = {"segmentation": "segmentation", "pose": "poses", "picking": "grasps, motion and physics"}


def assessment_lines(assessment: Assessment, numbers: Path) -> list[str]:
    """Return what was measured and what to do, each line with its label.

    Args:
        assessment: The assessment.
        numbers: JSON file that holds all of it.
    """
    lines = [_line(name, text) for name, text in finding_words(assessment.findings)]
    took = ", ".join(f"{name} {seconds:.0f} s" for name, seconds in assessment.seconds.items())
    lines.append(_line("time", f"{took}; together {sum(assessment.seconds.values()):.0f} s"))
    lines.append(_line("numbers", str(numbers)))
    if not assessment.advice:
        lines.append(_line("advice", "nothing to change"))
    for piece in assessment.advice:
        lines += [_line("advice", piece.text), _line("", f"because {piece.because}")]
    return lines


def finding_words(findings: Findings) -> list[tuple[str, str]]:
    """Return what was measured as (label, text)."""
    seen, picked = findings.perception, findings.picking
    words = [("part", part_words(findings.part)), ("rests", rest_words(findings)), ("seen", sight_words(findings))]
    words.append(("grasps", grip_words(findings.grip)))
    words.append(("scenes", f"not run: {findings.not_perceived}" if seen is None else perception_words(seen)))
    if picked is None:
        words.append(("picks", f"not run: {findings.not_picked}"))
    else:
        words += [("picks", picking_words(picked)), ("lost", loss_words(picked))]
    return words


def part_words(part: PartFacts) -> str:
    """Return what a part is."""
    unit = "no file" if part.unit_origin is None else f"read as {part.unit} ({part.unit_origin})"
    size = " x ".join(f"{1000 * side:.0f}" for side in part.size)
    bodies = f"{part.bodies} bod{'y' if part.bodies == 1 else 'ies'}"
    repairs = "no repairs" if not part.repairs else "; ".join(part.repairs)
    return f"{unit}, {size} mm, {1000 * part.mass:.0f} g, symmetry {part.symmetry}, {bodies}, {repairs}"


def rest_words(findings: Findings) -> str:
    """Return how often a part rests in which pose, and how many grasps pick it up from there."""
    poses = zip(findings.rests, findings.grip.at_rest, strict=True)
    shown = [
        f"{100 * rest.share:.0f} % {1000 * rest.height:.0f} mm high ({count or 'no'} grasps off the floor)"
        for rest, count in list(poses)[:3]
    ]
    more = len(findings.rests) - len(shown)
    return "; ".join(shown) + (f"; {more} rarer poses" if more else "")


def sight_words(findings: Findings) -> str:
    """Return how large a part is in the image, and how much of the parts is visible."""
    sight, seen = findings.sight, findings.perception
    words = f"{sight.d_max_px:.0f} px long, {sight.points:.0f} boundary points unoccluded"
    if seen is None:
        return words
    below = percent(seen.clutter["below_half"])
    return f"{words}; in piles median visible fraction {number(seen.clutter['median'], 2)}, {below} under 0.5"


def grip_words(grip: GripFacts) -> str:
    """Return how many grasps a part has, and where."""
    if grip.widths is None:
        return f"none: {grip.reason}"
    low, high = (1000 * width for width in grip.widths)
    share = percent(grip.graspable_share)
    return f"{grip.grasps}, {low:.0f} to {high:.0f} mm wide; after {share} of drops some pick the part off the floor"


def perception_words(seen: PerceptionFacts) -> str:
    """Return how well parts are found on fresh scenes."""
    return (
        f"AP {_share(seen.ap)} ({seen.weights}, {seen.training}), recognition {_share(seen.recognition)}, "
        f"recall {_share(seen.recall)}, precision {_share(seen.precision)} in {counted(seen.scenes, 'scene')}"
    )


def picking_words(picked: PickingFacts) -> str:
    """Return how many parts are delivered, from pixels and with ground truth."""
    rates: Sequence[str] = [percent(picked.dr[mode]) for mode in reversed(MODES)]
    return (
        f"{rates[0]} of {picked.parts} parts delivered, {rates[1]} with true segments, {rates[2]} with true poses; "
        f"GSR {percent(picked.gsr['learned'])}, {number(picked.mpph['learned'], 0)} picks per hour, "
        f"{counted(picked.bins, 'bin')}"
    )


def loss_words(picked: PickingFacts) -> str:
    """Return how many of all parts each stage loses."""
    losses = picked.losses
    shares = ", ".join(f"{words} {percent(getattr(losses, name))}" for name, words in STAGES.items())
    largest = losses.largest()
    return f"{shares} of the parts" + (f"; most by {STAGES[largest]}" if largest else "")


def _share(value: float) -> str:
    return percent(None if value != value else value)  # NaN where there is nothing to count


def _line(label: str, text: str) -> str:
    return f"{label:<{_LABEL}}{text}"
