"""The numbers of an evaluation, from the records of its bins; the field names are the keys of results.json."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.scenes.clutter import pooled_clutter
from perception.runtime.files import json_text, write_atomically
from perception.runtime.provenance import command_line, versions
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.double_summary import summarise_doubles
from policies.evaluation.failure_attribution import FailureStage
from policies.evaluation.frame_summary import over_bins, summarise_frames
from policies.evaluation.records import BinRecord
from policies.evaluation.statistics import Interval, Rate, bootstrap_ratio, rate
from policies.grasping.outcomes import Abstention, GraspOutcome, PushOutcome
from policies.picking.episode import Termination


@dataclass(frozen=True, kw_only=True)
class Summary:
    """The numbers of an evaluation. A rate is None where there was no trial; intervals are 95 %.

    Attributes:
        gsr: Grasp success rate: successes / attempts, pooled over the bins.
        dr: Declutter rate: parts delivered / parts settled, pooled.
        mpph: Mean picks per hour, 3600 q / (t_sense + t_compute + t_motion), means over attempts; the time of pushes is
            added.
        mpph_overlapped: The same on one clock, on which what is sensed and computed during a motion takes no time of
            its own: 3600 q / (t_sense + t_compute + t_motion - t_concurrent).
        motion_dph: Deliveries per hour of simulated motion alone, 3600 q / t_motion.
        attempts: Number of executed attempts.
        successes: Number of attempts that delivered exactly one part.
        parts_total: Number of parts after settling.
        delivered: Number of parts delivered.
        lost: Number of parts that left play without being delivered: more than one at a time, fallen out of the bin, or
            fallen into the tray unreleased.
        abstentions: Number of decisions without an attempt, by reason.
        termination: Number of bins, by the reason why they ended.
        outcomes: Number of attempts, by how they ended.
        pushes: Number of pushes, by how they ended. Their time counts in all rates per hour.
        doubles: Number of ``lifts`` with a part and of ``doubles`` among them, and what the detectors ``jaw``,
            ``weight`` and ``image``, and ``either`` of them, said: ``detected``, ``missed`` and ``false_alarms``.
            ``lifts`` of ``image`` counts those after which an image was taken.
        time: Means over attempts [s]: sense (nominal), compute (wall clock, one core), motion (simulated), and
            concurrent, the part of sense and compute that passed during the motion of the attempt before.
        wall: Wall clock without listeners such as pictures: mean of an attempt without the drop [s], mean of a bin
            with the drop [s], and the share of the whole in which frames were rendered.
        ap: ScanNet's AP of the segments that poses were searched in, over all frames that decisions were made on; None
            where nothing is segmented (oracle).
        ap50: Average precision at an IoU of 0.5, likewise.
        ap75: Average precision at an IoU of 0.75, likewise.
        explained: The three average precisions after points were assigned to poses.
        candidate_pose_accuracy: Share of candidates whose pose is correct for the part that owns most of their points:
            within a tenth of d_max and 5 deg.
        candidate_precision: Share of candidates that are the best-scored correct pose of some part.
        candidate_recall: Share of the parts to find, frame by frame, that have a candidate with a correct pose.
        candidates: Number of candidates in all frames.
        parts_to_find: Number of parts visible to a half or more, summed over all frames.
        pose_error: Medians over all candidates that have a part: "mm" at its centre, "deg" modulo symmetry.
        failure_attribution: Number of failed attempts, by the stage at which they failed.
        frames: Number of frames that decisions were made on.
        frame_causes: Number of these frames by the likely causes of lost parts that their reports name.
        perception_ms: Median wall clock of each stage of perception for a frame [ms].
        clutter: Visible fractions in the settled bins: median (mean of the bins' medians), below_half and
            above_nine_tenths (shares of all parts), and the number of parts.
        camera_backend: What rendered the frames.
        weights: ``name``, ``sha256`` and ``training`` ("own", "family" or "zero-shot") of the segmentation network;
            None where perception uses none.
        intervals: Intervals of gsr and dr (Wilson), of the three rates per hour (bootstrap over attempts), of
            gsr_bins and dr_bins (the same rates, percentile bootstrap over whole bins; None for a single bin), and
            over bins likewise of ap, ap50, ap75 and the three rates of candidates, which are never narrower than
            Wilson's.
        bins: Number of bins.
        seed: Seed of the evaluation.
        config: Every setting of the evaluation, by name.
        command: Command line of the process that computed the summary.
        git_commits: Commits of the code that made the records; more than one if the code changed between them.
        versions: Versions of Python, platform and packages.
    """

    gsr: float | None
    dr: float | None
    mpph: float | None
    mpph_overlapped: float | None
    motion_dph: float | None
    attempts: int
    successes: int
    parts_total: int
    delivered: int
    lost: int
    abstentions: dict[str, int]
    termination: dict[str, int]
    outcomes: dict[str, int]
    pushes: dict[str, int] = field(default_factory=dict)
    doubles: dict[str, int | dict[str, int]] = field(default_factory=dict)
    time: dict[str, float | None]
    wall: dict[str, float | None]
    ap: float | None = None
    ap50: float | None = None
    ap75: float | None = None
    explained: dict[str, float | None]
    candidate_pose_accuracy: float | None = None
    candidate_precision: float | None
    candidate_recall: float | None
    candidates: int
    parts_to_find: int
    pose_error: dict[str, float | None]
    failure_attribution: dict[str, int]
    frames: int
    frame_causes: dict[str, int] = field(default_factory=dict)
    perception_ms: dict[str, float]
    clutter: dict[str, float | None]
    camera_backend: str
    weights: dict[str, str] | None = None
    intervals: dict[str, Interval | None]
    bins: int
    seed: int
    config: dict[str, Any]
    command: str
    git_commits: list[str]
    versions: dict[str, str] = field(default_factory=versions)

    @property
    def gsr_rate(self) -> Rate:
        """Grasp success rate with its Wilson interval."""
        return rate(self.successes, self.attempts)

    @property
    def dr_rate(self) -> Rate:
        """Declutter rate with its Wilson interval."""
        return rate(self.delivered, self.parts_total)

    @property
    def failures(self) -> int:
        """Number of attempts that did not deliver exactly one part."""
        return self.attempts - self.successes

    def plain(self) -> dict[str, Any]:
        """Return every field by its name, as results.json holds it."""
        # The previous name of the failure attribution is written, too, for one version.
        return {**asdict(self), "blame": self.failure_attribution}


def summarise(records: Sequence[BinRecord], config: EvaluationConfig, rng: np.random.Generator) -> Summary:
    """Pool the bins of an evaluation.

    Args:
        records: Records of the bins, all made with ``config``.
        config: Configuration of the evaluation.
        rng: Random numbers for the bootstrap.

    Raises:
        ValueError: There are no records, or one was made with another configuration.
    """
    digest = config.digest()
    if not records:
        raise ValueError("there is nothing to summarise: no bin was evaluated")
    if others := [record.index for record in records if record.config_hash != digest]:
        raise ValueError(f"bins {others} are of another configuration")
    attempts = [pick for record in records for pick in record.attempts]
    delivering = np.array([pick.outcome is GraspOutcome.DELIVERED for pick in attempts], dtype=np.float64)
    times = np.array([(a.t_sense, a.t_compute, a.t_motion, a.t_concurrent) for a in attempts]).reshape(-1, 4)
    successes, settled = int(delivering.sum()), sum(record.parts_total for record in records)
    delivered = sum(record.delivered for record in records)
    gsr, dr = rate(successes, len(attempts)), rate(delivered, settled)
    bins = [(sum(a.outcome is GraspOutcome.DELIVERED for a in r.attempts), len(r.attempts)) for r in records]
    timed = [pick for record in records for pick in record.timed]
    spent = np.array([(a.seconds, a.seconds - a.t_concurrent, a.t_motion) for a in timed]).reshape(-1, 3)
    counted = np.array([pick.outcome is GraspOutcome.DELIVERED for pick in timed], dtype=np.float64)
    pushes = [pick.push for pick in timed if pick.push is not None]
    mpph, mpph_interval = _per_hour(counted, spent[:, 0], rng)
    motion_dph, motion_interval = _per_hour(counted, spent[:, 2], rng)
    gsr_bins = over_bins(bins, rng)
    dr_bins = over_bins([(record.delivered, record.parts_total) for record in records], rng)
    perception = summarise_frames(records, rng)
    overlapped, overlapped_interval = _per_hour(counted, spent[:, 1], rng)
    return Summary(
        gsr=gsr.value,
        dr=dr.value,
        mpph=mpph,
        mpph_overlapped=overlapped,
        motion_dph=motion_dph,
        attempts=len(attempts),
        successes=successes,
        parts_total=settled,
        delivered=delivered,
        lost=sum(record.lost for record in records),
        abstentions=_count(Abstention, [p.abstention for r in records for p in r.picks if p.abstention is not None]),
        termination=_count(Termination, [record.termination for record in records]),
        outcomes=_count(GraspOutcome, [pick.outcome for pick in attempts]),
        pushes=_count(PushOutcome, pushes),
        doubles=summarise_doubles(pick.double_check for pick in attempts if pick.double_check is not None),
        time={name: _mean(times[:, k]) for k, name in enumerate(("sense", "compute", "motion", "concurrent"))},
        wall=_wall(records, len(attempts)),
        ap=perception.ap["ap"],
        ap50=perception.ap["ap50"],
        ap75=perception.ap["ap75"],
        candidate_pose_accuracy=perception.rates["candidate_pose_accuracy"],
        candidate_precision=perception.rates["candidate_precision"],
        candidate_recall=perception.rates["candidate_recall"],
        explained=perception.explained,
        candidates=perception.counts["candidate_pose_accuracy"][1],
        parts_to_find=perception.counts["candidate_recall"][1],
        pose_error=perception.errors,
        failure_attribution=_count(
            FailureStage, [p.failure_attribution for p in attempts if p.failure_attribution is not None]
        ),
        frames=perception.frames,
        frame_causes=perception.causes,
        perception_ms=perception.stages,
        clutter=pooled_clutter([record.clutter for record in records]),
        camera_backend=config.camera.backend,
        weights=config.weights(),
        intervals={
            "gsr": (gsr.low, gsr.high),
            "dr": (dr.low, dr.high),
            "mpph": mpph_interval,
            "mpph_overlapped": overlapped_interval,
            "motion_dph": motion_interval,
            "gsr_bins": gsr_bins,
            "dr_bins": dr_bins,
            **perception.intervals,
        },
        bins=len(records),
        seed=config.seed,
        config=asdict(config),
        command=command_line(),
        git_commits=sorted({record.git_commit for record in records}),
    )


def save_summary(path: Path, summary: Summary) -> None:
    """Write ``summary`` as JSON, in one piece."""
    write_atomically(path, json_text(summary.plain()))


def _count(kinds: Any, found: Sequence[Any]) -> dict[str, int]:
    """Count the values that are each member of an enum; members that do not occur count 0."""
    counts = Counter(found)
    return {str(kind): counts[kind] for kind in kinds}


def _mean(values: Any) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _per_hour(counts: Any, seconds: Any, rng: np.random.Generator) -> tuple[float | None, Interval | None]:
    """Return the rate per hour of (N,) counts in as many times, with its interval; None without attempts."""
    if len(counts) == 0 or seconds.min() <= 0:
        return None, None
    return float(3600 * counts.sum() / seconds.sum()), bootstrap_ratio(3600 * counts, seconds, rng)


def _wall(records: Sequence[BinRecord], attempts: int) -> dict[str, float | None]:
    wall = sum(record.wall for record in records)
    picking = wall - sum(record.settle for record in records)
    return {
        "attempt": picking / attempts if attempts else None,
        "bin": wall / len(records),
        "render_share": sum(record.render for record in records) / wall if wall > 0 else None,
    }
