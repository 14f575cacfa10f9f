"""From the bins' records to the numbers that are printed; the field names are the keys of results.json."""

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
from policies.evaluation.failure_attribution import Blame
from policies.evaluation.frame_summary import over_bins, summarise_sight
from policies.evaluation.records import BinRecord
from policies.evaluation.statistics import Interval, Rate, bootstrap_ratio, rate
from policies.grasping.outcomes import Abstention, GraspOutcome
from policies.picking.episode import Termination


@dataclass(frozen=True, kw_only=True)
class Summary:
    """The main job's numbers. A rate is None where there was no trial; intervals are 95 %.

    Attributes:
        gsr: Grasp success rate: successes / attempts, pooled over the bins.
        dr: Declutter rate: parts delivered / parts settled, pooled.
        mpph: Mean picks per hour, 3600 q / (t_sense + t_compute + t_motion), means over attempts.
        motion_dph: Deliveries per hour of simulated motion alone, 3600 q / t_motion.
        attempts: Executed attempts.
        successes: Attempts that delivered exactly one part.
        parts_total: Parts after settling.
        delivered: Parts delivered.
        lost: Parts that left play without being delivered: doubles, fallen out of the bin or into the tray unreleased.
        abstentions: Decisions without an attempt, by reason.
        termination: Bins by the reason of their end.
        outcomes: Attempts by how they ended.
        time: Means over attempts [s]: sense (nominal), compute (wall clock, one core), motion (simulated).
        wall: Wall clock [s], pictures for people left out: an attempt's mean without the drop, a bin's mean with
            it, and the share of it that went into rendering frames.
        ap: ScanNet's AP of the groups that poses were searched in, over all frames that were decided on; None where
            nothing is segmented (oracle). Likewise ap50 and ap75.
        explained: The three after the poses have explained the points.
        candidate_pose_accuracy: Share of offered candidates whose pose is right for the part that most of their points
            are of: within a tenth of d_max and 5 deg.
        candidate_precision: Share that is right for some part, and the best-scored of that part.
        candidate_recall: Share of the parts visible to a half or more, frame by frame, that a right one was offered of.
        candidates: Number that was offered, in all frames. parts_to_find: what the recall is of.
        parts_to_find: See there.
        pose_error: Medians over the candidates, right or wrong: "mm" at the part's centre, "deg" modulo symmetry.
        blame: Failed attempts by the stage that they failed by.
        frames: That were decided on.
        perception_ms: Median wall clock of perception's stages by frame [ms].
        clutter: median (mean of the bins' medians), below_half and above_nine_tenths (shares of all parts), parts.
        camera_backend: What rendered the frames.
        intervals: Of gsr and dr (Wilson), of mpph and motion_dph (percentile bootstrap over attempts), of gsr_bins and
            dr_bins (the same rates, percentile bootstrap over whole bins; None for a single bin), and over bins
            likewise of ap, ap50, ap75 and the three rates of candidates, these never narrower than Wilson's.
        bins: Number of bins.
        seed: Of the evaluation.
        config: All settings.
        command: Command line of the process that summed up.
        git_commits: Of the code that made the records; more than one if the code changed between them.
        versions: Python, platform and packages.
    """

    gsr: float | None
    dr: float | None
    mpph: float | None
    motion_dph: float | None
    attempts: int
    successes: int
    parts_total: int
    delivered: int
    lost: int
    abstentions: dict[str, int]
    termination: dict[str, int]
    outcomes: dict[str, int]
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
    blame: dict[str, int]
    frames: int
    perception_ms: dict[str, float]
    clutter: dict[str, float | None]
    camera_backend: str
    intervals: dict[str, Interval | None]
    bins: int
    seed: int
    config: dict[str, Any]
    command: str
    git_commits: list[str]
    versions: dict[str, str] = field(default_factory=versions)

    @property
    def gsr_rate(self) -> Rate:
        """GSR with its interval."""
        return rate(self.successes, self.attempts)

    @property
    def dr_rate(self) -> Rate:
        """DR with its interval."""
        return rate(self.delivered, self.parts_total)

    @property
    def failures(self) -> int:
        """Attempts that did not deliver exactly one part."""
        return self.attempts - self.successes


def summarise(records: Sequence[BinRecord], config: EvaluationConfig, rng: np.random.Generator) -> Summary:
    """Pool the bins.

    Args:
        records: Of one configuration.
        config: That configuration.
        rng: The bootstrap's chance.

    Raises:
        ValueError: There are no records, or one is of another configuration.
    """
    digest = config.digest()
    if not records:
        raise ValueError("there is nothing to sum up: no bin was evaluated")
    if strangers := [record.index for record in records if record.config_hash != digest]:
        raise ValueError(f"bins {strangers} are of another configuration")
    attempts = [pick for record in records for pick in record.attempts]
    gains = np.array([pick.outcome is GraspOutcome.DELIVERED for pick in attempts], dtype=np.float64)
    times = np.array([(a.t_sense, a.t_compute, a.t_motion) for a in attempts]).reshape(-1, 3)
    successes, settled = int(gains.sum()), sum(record.parts_total for record in records)
    delivered = sum(record.delivered for record in records)
    gsr, dr = rate(successes, len(attempts)), rate(delivered, settled)
    bins = [(sum(a.outcome is GraspOutcome.DELIVERED for a in r.attempts), len(r.attempts)) for r in records]
    mpph, mpph_interval = _per_hour(gains, times.sum(axis=1), rng)
    motion_dph, motion_interval = _per_hour(gains, times[:, 2], rng)
    gsr_bins = over_bins(bins, rng)
    dr_bins = over_bins([(record.delivered, record.parts_total) for record in records], rng)
    sight = summarise_sight(records, rng)
    return Summary(
        gsr=gsr.value,
        dr=dr.value,
        mpph=mpph,
        motion_dph=motion_dph,
        attempts=len(attempts),
        successes=successes,
        parts_total=settled,
        delivered=delivered,
        lost=sum(record.lost for record in records),
        abstentions=_count(Abstention, [p.abstention for r in records for p in r.picks if p.abstention is not None]),
        termination=_count(Termination, [record.termination for record in records]),
        outcomes=_count(GraspOutcome, [pick.outcome for pick in attempts]),
        time={name: _mean(times[:, k]) for k, name in enumerate(("sense", "compute", "motion"))},
        wall=_wall(records, len(attempts)),
        ap=sight.ap["ap"],
        ap50=sight.ap["ap50"],
        ap75=sight.ap["ap75"],
        candidate_pose_accuracy=sight.rates["candidate_pose_accuracy"],
        candidate_precision=sight.rates["candidate_precision"],
        candidate_recall=sight.rates["candidate_recall"],
        explained=sight.explained,
        candidates=sight.counts["candidate_pose_accuracy"][1],
        parts_to_find=sight.counts["candidate_recall"][1],
        pose_error=sight.errors,
        blame=_count(Blame, [pick.blame for pick in attempts if pick.blame is not None]),
        frames=sight.frames,
        perception_ms=sight.stages,
        clutter=pooled_clutter([record.clutter for record in records]),
        camera_backend=config.camera.backend,
        intervals={
            "gsr": (gsr.low, gsr.high),
            "dr": (dr.low, dr.high),
            "mpph": mpph_interval,
            "motion_dph": motion_interval,
            "gsr_bins": gsr_bins,
            "dr_bins": dr_bins,
            **sight.intervals,
        },
        bins=len(records),
        seed=config.seed,
        config=asdict(config),
        command=command_line(),
        git_commits=sorted({record.git_commit for record in records}),
    )


def save_summary(path: Path, summary: Summary) -> None:
    """Write ``summary`` as JSON, in one piece."""
    write_atomically(path, json_text(asdict(summary)))


def _count(kinds: Any, found: Sequence[Any]) -> dict[str, int]:
    """Count every member of an enum, the absent ones too."""
    counts = Counter(found)
    return {str(kind): counts[kind] for kind in kinds}


def _mean(values: Any) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _per_hour(gains: Any, seconds: Any, rng: np.random.Generator) -> tuple[float | None, Interval | None]:
    if len(gains) == 0 or seconds.min() <= 0:
        return None, None
    return float(3600 * gains.sum() / seconds.sum()), bootstrap_ratio(3600 * gains, seconds, rng)


def _wall(records: Sequence[BinRecord], attempts: int) -> dict[str, float | None]:
    wall = sum(record.wall for record in records)
    picking = wall - sum(record.settle for record in records)
    return {
        "attempt": picking / attempts if attempts else None,
        "bin": wall / len(records),
        "render_share": sum(record.render for record in records) / wall if wall > 0 else None,
    }
