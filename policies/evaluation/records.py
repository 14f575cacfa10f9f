"""The record of every bin: plain numbers and words, written as JSON, one file per bin."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np

from binpick_env.scenes.clutter import ClutterStats
from perception.runtime.field_types import require_field_types
from perception.runtime.records import RecordError, RecordFormat
from policies.evaluation.failure_attribution import FailureStage, attribute_failure
from policies.evaluation.frame_record import CandidateRecord, FrameRecord
from policies.evaluation.undelivered import UndeliveredPart
from policies.grasping.outcomes import Abstention, DoubleCheck, GraspOutcome, PickResult, PushOutcome
from policies.picking.episode import BinResult, Termination

PICTURES = (".jpg", ".webp", ".png")  # kinds of pictures of a record
FORMAT = RecordFormat(kind="bin record", version=3, remedy="pick makes it again")


@dataclass(frozen=True, kw_only=True)
class PickRecord:
    """One decision; see :class:`policies.grasping.outcomes.PickResult`.

    Attributes:
        outcome: How the attempt ended; None if there was none.
        abstention: Why nothing was done; None for an attempt or a push.
        part: Index of the part that was aimed at, -1 if unknown.
        delivered: Number of parts that the attempt delivered.
        t_sense: Nominal time of the exposure [s].
        t_compute: Wall clock of perception and planning [s].
        t_motion: Simulated time of the motion [s].
        t_concurrent: Part of ``t_sense`` and ``t_compute`` that passed during the motion of the decision before [s].
        frame_id: Number of the frame that the decision was made on.
        width: Distance between the pads at contact [m]; None for an abstention.
        opening: Distance between the pads during the approach [m]; None for an abstention.
        score: Score by which the grasp was ranked; None for an abstention.
        features: Named scalars that the score was computed from.
        candidate: Index of the candidate in its frame's record; None for an abstention.
        failure_attribution: Stage at which a failed attempt failed; None for a delivery or an abstention, or if there
            is no record of its frame.
        picture: File name of the picture of the decision, beside the record; "" if there is none.
        push: How the push ended; None if there was none.
        double_check: What was measured of the load after the lift; None if nothing was lifted.
    """

    outcome: GraspOutcome | None
    abstention: Abstention | None
    part: int
    delivered: int
    t_sense: float
    t_compute: float
    t_motion: float
    frame_id: int
    width: float | None = None
    opening: float | None = None
    score: float | None = None
    features: dict[str, float] = field(default_factory=dict)
    candidate: int | None = None
    failure_attribution: FailureStage | None = None
    picture: str = ""
    push: PushOutcome | None = None
    double_check: DoubleCheck | None = None
    t_concurrent: float = 0.0

    @property
    def seconds(self) -> float:
        """Time of sensing, computing and motion, one after the other [s]."""
        return self.t_sense + self.t_compute + self.t_motion

    @property
    def ending(self) -> GraspOutcome | Abstention | PushOutcome | None:
        """How the decision ended, whichever kind it was."""
        return self.outcome or self.abstention or self.push

    @classmethod
    def from_result(cls, result: PickResult, picture: str = "", frame: FrameRecord | None = None) -> "PickRecord":
        """Return the plain facts of a decision.

        Args:
            result: What was decided, and how the attempt ended.
            picture: File name of the decision's picture; "" if there is none.
            frame: Record of the frame that the decision was made on; None if there is none.
        """
        grasp = result.grasp
        candidate = None if frame is None or grasp is None else frame.candidates[grasp.candidate]
        failed_at = None
        if candidate is not None and result.outcome is not None:
            failed_at = attribute_failure(result.outcome, candidate)
        return cls(
            outcome=result.outcome,
            abstention=result.abstention,
            part=result.part,
            delivered=result.delivered,
            t_sense=result.t_sense,
            t_compute=result.t_compute,
            t_motion=result.t_motion,
            frame_id=result.frame_id,
            width=None if grasp is None else float(grasp.width),
            opening=None if grasp is None else float(grasp.opening),
            score=None if grasp is None else float(grasp.score),
            features={} if grasp is None else {name: float(value) for name, value in grasp.features.items()},
            candidate=None if grasp is None else grasp.candidate,
            failure_attribution=failed_at,
            picture=picture,
            push=result.push,
            double_check=result.double_check,
            t_concurrent=result.t_concurrent,
        )


@dataclass(frozen=True, kw_only=True)
class BinRecord:
    """One bin.

    Attributes:
        config_hash: Digest of the :class:`policies.evaluation.config.EvaluationConfig` that the bin was picked with.
        index: Number of the bin in the evaluation, from 0.
        seed: Seed of the environment's reset.
        parts_total: Number of parts after settling.
        delivered: Number of parts delivered.
        termination: Why the bin ended.
        clutter: Visible fractions of the settled bin; its shares are NaN for an empty one.
        picks: Every decision, in order.
        frames: Every frame that a decision was made on, compared with the ground truth.
        wall: Wall clock of the bin after its set-up, without listeners such as pictures [s].
        settle: Part of ``wall`` in which the parts were dropped and the first frame was taken [s].
        render: Part of ``wall`` in which the camera's frames were rendered [s].
        git_commit: Commit of the code that made the record, "" outside of a checkout.
        before: File name of the picture of the settled bin; "" if there is none.
        after: File name of the picture of the bin's end; "" if there is none.
        lost: Number of parts that left play without being delivered.
        undelivered: The parts that were lost or left in the bin; None in records of earlier versions.
    """

    config_hash: str
    index: int
    seed: int
    parts_total: int
    delivered: int
    termination: Termination
    clutter: ClutterStats
    picks: tuple[PickRecord, ...]
    wall: float
    settle: float
    render: float
    frames: tuple[FrameRecord, ...] = ()
    git_commit: str = ""
    before: str = ""
    after: str = ""
    lost: int = 0
    undelivered: tuple[UndeliveredPart, ...] | None = None

    @property
    def attempts(self) -> tuple[PickRecord, ...]:
        """The decisions that led to an attempt."""
        return tuple(pick for pick in self.picks if pick.outcome is not None)

    @property
    def timed(self) -> tuple[PickRecord, ...]:
        """The attempts, pushes, and abstentions that moved the arm, whose time counts in rates per hour."""
        return tuple(pick for pick in self.picks if pick.abstention is None or pick.t_motion > 0)

    def frame(self, frame_id: int) -> FrameRecord | None:
        """Return the record of the frame with this number, None if there is none."""
        return next((frame for frame in self.frames if frame.frame_id == frame_id), None)

    def candidate(self, pick: PickRecord) -> CandidateRecord | None:
        """Return the candidate that was grasped, None for an abstention or if there is no record of its frame."""
        frame = self.frame(pick.frame_id)
        return None if frame is None or pick.candidate is None else frame.candidates[pick.candidate]

    @classmethod
    def from_result(
        cls, result: BinResult, pictures: list[str], frames: Sequence[FrameRecord] = (), **facts: Any
    ) -> "BinRecord":
        """Return the plain facts of a bin.

        Args:
            result: Every decision of the bin, and what came of them.
            pictures: File name of the picture of each decision, "" where there is none.
            frames: Records of the frames that decisions were made on.
            facts: The fields of the record that do not follow from these.
        """
        by_id = {frame.frame_id: frame for frame in frames}
        named = zip(result.picks, pictures, strict=True)
        picks = tuple(PickRecord.from_result(pick, name, by_id.get(pick.frame_id)) for pick, name in named)
        return cls(
            seed=result.seed,
            parts_total=result.parts_total,
            delivered=result.delivered,
            termination=result.termination,
            clutter=result.clutter,
            picks=picks,
            frames=tuple(frames),
            lost=result.lost,
            **facts,
        )


def record_path(folder: Path, index: int) -> Path:
    """Return the path of the record of bin ``index``."""
    return folder / f"bin_{index:04d}.json"


def save_record(record: BinRecord, folder: Path) -> Path:
    """Write ``record`` in one piece, or not at all, and return its path."""
    path = record_path(folder, record.index)
    values = asdict(record)
    for pick in values["picks"]:
        pick["blame"] = pick["failure_attribution"]  # the previous name, for one version
    FORMAT.save_plain(path, values, indent=None)  # a line for every number would be half spaces
    return path


def load_record(path: Path) -> BinRecord:
    """Read a record; those of earlier versions name the failure attribution "blame".

    Raises:
        RecordError: The file is cut off, damaged or of another version.
    """
    return FORMAT.load_plain(path, _bin)


def _bin(values: dict[str, Any]) -> BinRecord:
    clutter: dict[str, Any] = {name: np.nan if value is None else value for name, value in values["clutter"].items()}
    record = BinRecord(
        **{
            **values,
            "termination": Termination(values["termination"]),
            "clutter": ClutterStats(**clutter),
            "picks": tuple(_pick(pick) for pick in values["picks"]),
            "frames": tuple(FrameRecord.from_plain(frame) for frame in values["frames"]),
            "undelivered": _undelivered(values.get("undelivered")),
        }
    )
    require_field_types(record)
    for name in (record.before, record.after, *(pick.picture for pick in record.picks)):
        if name and not is_picture_name(name):
            raise ValueError(f"pictures must be named as .jpg, .webp or .png files beside the record, got {name!r}")
    return record


def is_picture_name(name: str) -> bool:
    """Tell whether a record's picture is a file beside it, of a kind that pages show."""
    return PurePosixPath(name).name == name == PureWindowsPath(name).name and Path(name).suffix in PICTURES


def _undelivered(values: list[dict[str, Any]] | None) -> tuple[UndeliveredPart, ...] | None:
    return None if values is None else tuple(UndeliveredPart.from_plain(part) for part in values)


def _pick(values: dict[str, Any]) -> PickRecord:
    if "blame" in values:
        previous = values["blame"]
        values = {"failure_attribution": previous} | {n: value for n, value in values.items() if n != "blame"}
    unknown = set(values) - {f.name for f in fields(PickRecord)}
    if unknown:
        raise RecordError(f"a pick has no field {', '.join(sorted(unknown))}")
    kinds = {
        "outcome": GraspOutcome,
        "abstention": Abstention,
        "failure_attribution": FailureStage,
        "push": PushOutcome,
    }
    values = {"push": None} | values  # records of earlier versions have none
    words = {name: None if values[name] is None else kind(values[name]) for name, kind in kinds.items()}
    check = values.get("double_check")
    return PickRecord(**{**values, **words, "double_check": None if check is None else DoubleCheck(**check)})
