"""What is kept of every bin: plain numbers and words, written as JSON, one file a bin."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.scenes.clutter import ClutterStats
from perception.runtime.records import RecordError, RecordFormat
from policies.evaluation.failure_attribution import Blame, blame
from policies.evaluation.frame_record import CandidateRecord, FrameRecord
from policies.grasping.outcomes import Abstention, GraspOutcome, PickResult
from policies.picking.episode import BinResult, Termination

FORMAT = RecordFormat(kind="bin record", version=3, remedy="pick makes it again")


@dataclass(frozen=True, kw_only=True)
class PickRecord:
    """One decision; see :class:`policies.grasping.outcomes.PickResult`.

    Attributes:
        outcome: A :class:`GraspOutcome`; None for an abstention.
        abstention: An :class:`Abstention`; None for an attempt.
        part: Index of the part that was aimed at, -1 if unknown.
        delivered: Parts delivered by it.
        t_sense: Nominal exposure [s].
        t_compute: Wall clock of perception and planning [s].
        t_motion: Simulated [s].
        frame_id: Frame of the decision.
        width: Distance between the pads at contact [m]; None for an abstention.
        opening: Distance between the pads during the approach [m]; None for an abstention.
        score: The grasp's rank; None for an abstention.
        features: Named scalars behind the score.
        candidate: Row of the candidate in its frame's record; None for an abstention.
        blame: What a failed attempt failed by; None for a delivery or an abstention, or if its frame was not judged.
        picture: File name of the picture of the decision, beside the record; "" if none was kept.
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
    blame: Blame | None = None
    picture: str = ""

    @classmethod
    def from_result(cls, result: PickResult, picture: str = "", frame: FrameRecord | None = None) -> "PickRecord":
        """Keep the plain facts of ``result``, judged by the record of the ``frame`` that it was decided on."""
        grasp = result.grasp
        tried = None if frame is None or grasp is None else frame.candidates[grasp.candidate]
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
            blame=None if tried is None or result.outcome is None else blame(result.outcome, tried),
            picture=picture,
        )


@dataclass(frozen=True, kw_only=True)
class BinRecord:
    """One bin.

    Attributes:
        config_hash: Of the :class:`policies.evaluation.bin_evaluation.EvaluationConfig` that made it.
        index: Of the bin in the evaluation.
        seed: Of the environment's reset.
        parts_total: Parts after settling.
        delivered: Parts delivered.
        termination: Why the bin ended.
        clutter: Visible fractions of the settled bin; its shares are NaN for an empty one.
        picks: Every decision in order.
        frames: What perception made of each frame that was decided on, judged.
        wall: Wall clock of the bin after its set-up, pictures for people left out [s].
        settle: Part of ``wall`` in which the pile was dropped and seen first [s].
        render: Part of ``wall`` spent on rendering the camera's frames [s].
        git_commit: Of the code that made it, "" outside of a checkout.
        before: File name of the picture of the settled bin; "" if none was kept.
        after: File name of the picture at the bin's end; "" if none was kept.
        lost: Parts that left play without being delivered.
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

    @property
    def attempts(self) -> tuple[PickRecord, ...]:
        """The executed attempts."""
        return tuple(pick for pick in self.picks if pick.outcome is not None)

    def frame(self, frame_id: int) -> FrameRecord | None:
        """Return the record of a frame, None if it was not judged."""
        return next((frame for frame in self.frames if frame.frame_id == frame_id), None)

    def candidate(self, pick: PickRecord) -> CandidateRecord | None:
        """Return what an attempt was made on, None for an abstention or if its frame was not judged."""
        frame = self.frame(pick.frame_id)
        return None if frame is None or pick.candidate is None else frame.candidates[pick.candidate]

    @classmethod
    def from_result(
        cls, result: BinResult, pictures: list[str], frames: Sequence[FrameRecord] = (), **facts: Any
    ) -> "BinRecord":
        """Keep the plain facts of ``result``.

        Args:
            result: Of the bin.
            pictures: A file name, or "", for each pick.
            frames: That were decided on, judged.
            facts: The other fields.
        """
        seen = {frame.frame_id: frame for frame in frames}
        named = zip(result.picks, pictures, strict=True)
        picks = tuple(PickRecord.from_result(pick, name, seen.get(pick.frame_id)) for pick, name in named)
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
    """Return where the record of bin ``index`` is kept."""
    return folder / f"bin_{index:04d}.json"


def save_record(record: BinRecord, folder: Path) -> Path:
    """Write ``record`` in one piece, or not at all."""
    path = record_path(folder, record.index)
    FORMAT.save_plain(path, asdict(record), indent=None)  # a line for every number would be half spaces
    return path


def load_record(path: Path) -> BinRecord:
    """Read a record.

    Raises:
        RecordError: The file is cut off, damaged or of another version.
    """
    return FORMAT.load_plain(path, _bin)


def _bin(values: dict[str, Any]) -> BinRecord:
    clutter: dict[str, Any] = {name: np.nan if value is None else value for name, value in values["clutter"].items()}
    return BinRecord(
        **{
            **values,
            "termination": Termination(values["termination"]),
            "clutter": ClutterStats(**clutter),
            "picks": tuple(_pick(pick) for pick in values["picks"]),
            "frames": tuple(FrameRecord.from_plain(frame) for frame in values["frames"]),
        }
    )


def _pick(values: dict[str, Any]) -> PickRecord:
    unknown = set(values) - {f.name for f in fields(PickRecord)}
    if unknown:
        raise RecordError(f"a pick has no field {', '.join(sorted(unknown))}")
    for name, kind in (("outcome", GraspOutcome), ("abstention", Abstention), ("blame", Blame)):
        values[name] = None if values[name] is None else kind(values[name])
    return PickRecord(**values)
