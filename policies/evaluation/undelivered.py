"""Parts that a bin ended without delivering: where they lay, and why each was lost or left."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from binpick_env.cell.delivery import Delivery, DeliveryEvent
from binpick_env.env import BinPickEnv
from binpick_env.observation.labelled_capture import LabelledCapture
from perception.geometry import Floats, invert_transform, transform_points
from policies.evaluation.frame_record import FrameRecord
from policies.grasping.outcomes import Abstention, GraspCandidate
from policies.picking.episode import Picker
from policies.picking.plan import Plan
from policies.picking.scripted import ScriptedPicker


class LeftReason(StrEnum):
    """Why a part was left in the bin, by what the picker made of its candidates in the last frame."""

    NO_CANDIDATE = "no_candidate"  # perception found no candidate of the part
    NO_CLEAR_APPROACH = "no_clear_approach"  # every grasp would touch a neighbour or a wall, or failed before
    IK_INFEASIBLE = "ik_infeasible"  # clear grasps exist, but the arm reaches none of them
    NOT_TRIED = "not_tried"  # a grasp could be planned, but the bin ended before it was tried


@dataclass(frozen=True, kw_only=True)
class UndeliveredPart:
    """A part that was lost, or left in the bin.

    Attributes:
        part: Index of the part.
        position: (3,) centre of the part in the bin frame [m]: at the end of the bin if the part was left, and where it
            last lay inside the bin if it was lost.
        visible_fraction: Visible fraction of the part in the frame of that position.
        lost: How the part left play; None if it was left in the bin.
        decision: Number of the decision during which the part was lost; None if it was left.
        reason: Why the part was left; None if it was lost, or if the picker does not tell.
        pose_correct: Whether any candidate of the left part has a correct pose; None without a candidate.
    """

    part: int
    position: tuple[float, float, float]
    visible_fraction: float
    lost: Delivery | None = None
    decision: int | None = None
    reason: LeftReason | None = None
    pose_correct: bool | None = None

    @classmethod
    def from_plain(cls, values: dict[str, Any]) -> "UndeliveredPart":
        """Return the part whose fields are given as JSON types."""
        lost, reason = values["lost"], values["reason"]
        return cls(
            **{
                **values,
                "position": tuple(values["position"]),
                "lost": None if lost is None else Delivery(lost),
                "reason": None if reason is None else LeftReason(reason),
            }
        )


class LossWatch:
    """Notes where the parts of one bin lie at each decision, and which of them are lost during it."""

    def __init__(self) -> None:
        self.lost: list[UndeliveredPart] = []
        self._last: dict[int, tuple[tuple[float, float, float], float]] = {}  # place and visible fraction inside
        self._events = 0  # number of events that are dealt with

    def before(self, view: LabelledCapture) -> None:
        """Note the places of the parts in the frame that a decision is made on."""
        for part, (centre, inside) in enumerate(zip(*_centres(view), strict=True)):
            if inside or part not in self._last:
                self._last[part] = _triple(centre), float(view.visible_fractions[part])

    def after(self, events: Sequence[DeliveryEvent], decision: int) -> None:
        """Note the parts that left play undelivered.

        Args:
            events: Everything that left play in this bin so far.
            decision: Number of the decision.
        """
        for event in events[self._events :]:
            if event.kind is not Delivery.DELIVERED:
                place, visible = self._last[event.part]
                self.lost.append(
                    UndeliveredPart(
                        part=event.part, position=place, visible_fraction=visible, lost=event.kind, decision=decision
                    )
                )
        self._events = len(events)


def left_parts(env: BinPickEnv, picker: Picker, frame: FrameRecord) -> list[UndeliveredPart]:
    """Return the parts still in play, with the reason why each was left.

    Args:
        env: The cell after the bin's last decision; it is not changed.
        picker: Picker that made the decisions.
        frame: The last frame's candidates, compared with the ground truth.

    Note:
        The picker plans for each candidate of a left part until it finds a motion: up to some tenths of a second a bin.
    """
    view = env.labelled_capture
    left = np.flatnonzero(env.simulation.in_play[: len(view.T_world_parts)]).tolist()
    if not left:
        return []
    verdicts = candidate_verdicts(picker, len(frame.candidates)) if isinstance(picker, ScriptedPicker) else None
    centres, _ = _centres(view)
    return [
        UndeliveredPart(
            part=part,
            position=_triple(centres[part]),
            visible_fraction=float(view.visible_fractions[part]),
            reason=None if verdicts is None else _reason(part, frame, verdicts),
            pose_correct=_pose_correct(part, frame),
        )
        for part in left
    ]


def candidate_verdicts(picker: ScriptedPicker, candidates: int) -> list[Abstention | None]:
    """Return for each candidate of the last frame why it cannot be picked; None where a motion is found.

    Args:
        picker: The picker, with the failed attempts of the bin.
        candidates: Number of candidates in the frame.
    """
    grasps: dict[int, list[GraspCandidate]] = defaultdict(list)
    for grasp in picker.grasps() if candidates else []:
        grasps[grasp.candidate].append(grasp)
    return [_verdict(picker, grasps[k][: picker.settings.grasps_tried]) for k in range(candidates)]


def _verdict(picker: ScriptedPicker, grasps: Sequence[GraspCandidate]) -> Abstention | None:
    reasons = set()
    for grasp in grasps:
        plan = picker.plan(grasp)
        if isinstance(plan, Plan):
            return None
        reasons.add(plan)
    return Abstention.IK_INFEASIBLE if reasons == {Abstention.IK_INFEASIBLE} else Abstention.NO_CLEAR_APPROACH


def _reason(part: int, frame: FrameRecord, verdicts: Sequence[Abstention | None]) -> LeftReason:
    """Return the reason of the candidate that came closest to an attempt."""
    reasons = {verdict for each, verdict in zip(frame.candidates, verdicts, strict=True) if each.part == part}
    if not reasons:
        return LeftReason.NO_CANDIDATE
    if None in reasons:
        return LeftReason.NOT_TRIED
    clear_but_unreached = Abstention.IK_INFEASIBLE in reasons
    return LeftReason.IK_INFEASIBLE if clear_but_unreached else LeftReason.NO_CLEAR_APPROACH


def _pose_correct(part: int, frame: FrameRecord) -> bool | None:
    poses = [candidate.right for candidate in frame.candidates if candidate.part == part]
    return any(poses) if poses else None


def _centres(view: LabelledCapture) -> tuple[Floats, Floats]:
    """Return the (P, 3) centres of all parts in the bin frame [m], and (P,) whether each is within the walls."""
    centres_world = view.T_world_parts[:, :3, :3] @ view.part.centre + view.T_world_parts[:, :3, 3]
    centres = transform_points(invert_transform(view.workspace.T_world_bin), centres_world)
    length, width, _ = view.workspace.inner_size
    return centres, (np.abs(centres[:, 0]) <= length / 2) & (np.abs(centres[:, 1]) <= width / 2)


def _triple(point: Floats) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 5) for value in point)
    return x, y, z
