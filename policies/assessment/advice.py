"""What to do about a part: a pure function from what was measured to pieces of advice."""

import shlex
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil, floor, isfinite
from typing import Literal

from binpick_env.config import GRIPPER_MASS, GRIPPER_STROKE, PAYLOAD
from binpick_env.option_words import option_words
from perception.metrics.matching import MIN_REGION
from policies.assessment.findings import Findings
from policies.assessment.picking import PickingFacts
from policies.assessment.sight import JITTER
from policies.evaluation.undelivered import LeftReason
from policies.picking.episode import Termination

AdviceKind = Literal["unit", "mesh", "symmetry", "weight", "bin", "camera", "jaw", "train"]
MIN_POINTS = 5.0 * MIN_REGION  # a part that is visible to a fifth then has the smallest number of points that counts
LOW_AP = 0.8  # AP under which training pays: networks that were trained on a part reach 0.94 and more
LOSS = 0.1  # share of the parts that a stage may lose without advice
LEAST_GRASPABLE = 0.5  # share of drops that must end in a pose that the jaw picks the part from
_OF_TRAINING = ("part", "unit")  # options that a training knows


@dataclass(frozen=True, kw_only=True)
class Advice:
    """One piece of advice.

    Attributes:
        kind: What is to be changed.
        text: What to do.
        because: What was measured that calls for it.
    """

    kind: AdviceKind
    text: str
    because: str


def advise(findings: Findings) -> tuple[Advice, ...]:
    """Return what to do about a part, in the order in which to do it; empty if nothing is to be done.

    What comes first changes what follows: a part in the wrong unit needs no other jaw. Training is advised only once
    the camera sees enough of the part, since a network is trained for one camera distance.

    Args:
        findings: Everything that was measured.
    """
    pieces = [*_unit(findings), *_mesh(findings), *_symmetry(findings)]
    if too_heavy := [*_weight(findings)]:
        pieces += too_heavy
        findings = replace(findings, picking=None)  # what failed in picking failed for the weight
    pieces += _bin(findings)
    pieces += _camera(findings)
    pieces += _jaw(findings)
    if not any(piece.kind == "camera" for piece in pieces):
        pieces += _train(findings)
    return tuple(pieces)


def _unit(findings: Findings) -> Iterator[Advice]:
    part = findings.part
    if part.other_units:
        read = ", ".join(f"{1000 * size:.0f} mm in {unit}" for unit, size in part.other_units.items())
        yield Advice(
            kind="unit",
            text=f"Name the unit: --unit {part.unit} if the part is {1000 * part.d_max:.0f} mm long; else --unit "
            + " or --unit ".join(part.other_units),
            because=f"{part.unit} was guessed, as the file names no unit; the part would be plausible with {read}, too",
        )


def _mesh(findings: Findings) -> Iterator[Advice]:
    if findings.part.repairs:
        yield Advice(
            kind="mesh",
            text="Check the mesh against the drawing, or export the part again as one closed solid",
            because=f"the file was repaired: {'; '.join(findings.part.repairs)}",
        )


def _symmetry(findings: Findings) -> Iterator[Advice]:
    near = findings.part.near_symmetry
    if near is not None:
        tolerance = ceil(1e4 * near.deviation + 0.5) / 1e4
        yield Advice(
            kind="symmetry",
            text=f"If poses turned by {near.angle_deg:.0f}° serve as well: --symmetry-tolerance {tolerance:g}; else "
            "expect them to be confused",
            because=f"a turn by {near.angle_deg:.0f}° changes the surface by {1000 * near.deviation:.2f} mm only, and "
            f"symmetries are taken up to {1000 * near.tolerance:.2f} mm",
        )


def _weight(findings: Findings) -> Iterator[Advice]:
    part = findings.part
    largest = PAYLOAD - GRIPPER_MASS
    if part.mass > largest:
        yield Advice(
            kind="weight",
            text="Use an arm that carries more; or name the density of the part [kg/m^3] if it is not right: --density",
            because=f"the part weighs {part.mass:.1f} kg at {part.density:.0f} kg/m^3, and a UR5e with this gripper "
            f"carries up to {largest:.1f} kg",
        )


def _bin(findings: Findings) -> Iterator[Advice]:
    facts, picking = findings.bin, findings.picking
    size = " x ".join(f"{1000 * side:.0f}" for side in facts.inner_size)
    d_max = findings.part.d_max
    if d_max > facts.largest_d_max:
        side = ceil(1000 * min(facts.inner_size[:2]) * d_max / facts.largest_d_max)
        yield Advice(
            kind="bin",
            text=f"Use a bin whose shorter side is {side} mm or more",
            because=f"the part is {1000 * d_max:.0f} mm long, and a bin of {size} mm holds a pile of parts up to "
            f"{1000 * facts.largest_d_max:.0f} mm",
        )
    elif facts.capacity < facts.wanted:
        yield Advice(
            kind="bin",
            text=f"Use a bin of {facts.wanted / facts.capacity:.1f} times the volume, or fewer parts "
            f"(--min-parts, --max-parts)",
            because=f"a bin of {size} mm holds {facts.capacity} of these parts, and {facts.wanted} were to lie in it",
        )
    elif picking is not None and picking.losses.picking >= LOSS and _for_room(picking):
        yield Advice(
            kind="bin",
            text="Use a wider or shallower bin, so that the fingers reach beside the parts",
            because=f"with true poses {_blocked(picking)} of {picking.parts} parts were left because walls and "
            "neighbours block the fingers or the arm",
        )


def _for_room(picking: PickingFacts) -> bool:
    """Tell whether bins with true poses ended for want of room rather than by failed attempts."""
    no_room, failing = (picking.ends.get(str(end), 0) for end in (Termination.ABSTAINED, Termination.TWO_FAILURES))
    return (no_room, _blocked(picking)) > (failing, picking.failed)


def _blocked(picking: PickingFacts) -> int:
    """Return the number of parts that were left in spite of true poses for want of room."""
    reasons = LeftReason.NO_CLEAR_APPROACH, LeftReason.IK_INFEASIBLE
    return sum(picking.left.get(str(reason), 0) for reason in reasons)


def _camera(findings: Findings) -> Iterator[Advice]:
    sight, picking = findings.sight, findings.picking
    least = sight.nearest + JITTER
    if not sight.whole_bin:
        yield Advice(
            kind="camera",
            text=f"Move the camera away: --camera-distance {ceil(100 * least) / 100:.2f}",
            because=f"at {sight.distance:g} m it does not see the whole bin, whose rim fills the image at "
            f"{sight.nearest:.2f} m",
        )
    elif sight.points < 1:  # the grey image is overexposed from very near
        yield Advice(
            kind="camera",
            text=f"Move the camera away: --camera-distance {ceil(150 * sight.distance) / 100:.2f}",
            because=f"at {sight.distance:g} m the image shows no edge of the part",
        )
    elif sight.points < MIN_POINTS:
        yield Advice(
            kind="camera",
            text=_closer(findings, MIN_POINTS / sight.points),
            because=f"a whole part has {sight.points:.0f} boundary points in the image; with {MIN_POINTS:.0f} a part "
            f"visible to a fifth has the {MIN_REGION} that count",
        )
    elif picking is not None and picking.losses.pose >= LOSS and findings.part.near_symmetry is None:
        yield Advice(
            kind="camera",
            text=_closer(findings, 1.5),
            because=f"true poses deliver {100 * picking.losses.pose:.0f} % more of the parts than poses in true "
            f"segments, from {sight.points:.0f} boundary points of a whole part",
        )


def _closer(findings: Findings, factor: float) -> str:
    """Return how to see a part ``factor`` times as large: from nearer if the whole bin stays in the image."""
    sight = findings.sight
    wanted = floor(100 * (sight.distance - sight.depth * (1 - 1 / factor))) / 100
    least = ceil(100 * (sight.nearest + JITTER)) / 100
    if wanted >= least:
        return f"Bring the camera nearer: --camera-distance {wanted:.2f}"
    width, height = (32 * ceil(factor * side / 32) for side in sight.image)
    text = f"Take a larger image: --width {width} --height {height}"
    if sight.distance <= least:
        return text
    return f"{text}; or use a smaller bin: from nearer than {least:.2f} m the camera does not see all of this one"


def _jaw(findings: Findings) -> Iterator[Advice]:
    grip, picking = findings.grip, findings.picking
    needed = 1000 * (grip.least_width + grip.stroke - grip.largest_width)
    if grip.grasps == 0:
        if grip.whole_stroke_grasps:
            text = f"Use a wider jaw: --jaw {GRIPPER_STROKE:g} takes the part, with {grip.whole_stroke_grasps} grasps"
        elif grip.largest_width < grip.least_width and isfinite(grip.least_width):
            text = f"Use another gripper, whose jaw opens {needed:.0f} mm or more; the 2F-85 opens 85 mm"
        else:
            text = (
                "Use another gripper, such as a suction cup or a magnet: no two faces lie opposite each other in reach"
            )
        yield Advice(kind="jaw", text=text, because=grip.reason or "the jaw finds no grasp")
    elif grip.graspable_share < LEAST_GRASPABLE:
        yield Advice(
            kind="jaw",
            text="Use another jaw: a wider one, or thinner fingers that reach under the part",
            because=f"{100 * (1 - grip.graspable_share):.0f} % of drops end in a pose from which no grasp picks the "
            f"part off the floor; the jaw takes widths up to {1000 * grip.largest_width:.0f} mm",
        )
    elif picking is not None and picking.losses.picking >= LOSS and picking.failed and not _for_room(picking):
        how = ", ".join(f"{count} {outcome.replace('_', ' ')}" for outcome, count in picking.failures.items())
        yield Advice(
            kind="jaw",
            text="Use another jaw: more force, or pads that fit the part",
            because=f"with true poses {picking.failed} of {picking.attempts} attempts failed ({how}); the part weighs "
            f"{1000 * findings.part.mass:.0f} g",
        )


def _train(findings: Findings) -> Iterator[Advice]:
    seen = findings.perception
    if seen is None or not seen.ap < LOW_AP:
        return
    scene, part = option_words(findings.options), option_words(findings.options, only=_OF_TRAINING)
    commands = [["binpick", "train-segmentation", *part, "--minutes", "30"]]
    if set(scene) != set(part):  # a cell of one's own, whose scenes the training does not make itself
        low, high = findings.bin.dropped
        filled = ["--min-parts", f"{low}", "--max-parts", f"{high}"]
        commands.insert(0, ["binpick", "generate-scenes", *scene, *filled, "--count", "300"])
    again = "Train the segmentation on the part"
    if seen.training == "own":
        again = "Train longer, on more scenes"
        commands[-1] += ["--seed", "1"]  # a folder of its own: that of seed 0 holds a training of another length
    yield Advice(
        kind="train",
        text=f"{again}: {' && '.join(map(shlex.join, commands))}",
        because=f"the AP of {seen.weights} ({seen.training}) is {100 * seen.ap:.0f} %; networks that were trained on a "
        "part reach 94 % and more",
    )
