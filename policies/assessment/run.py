"""An assessment step by step: the part, then perception on fresh scenes, then bins with the error budget."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from binpick_env.cell.settle import SettleError
from binpick_env.config import Perception
from binpick_env.evaluation.pose.evaluation import evaluate_poses
from binpick_env.evaluation.pose.scene_score import PoseSceneScore, load_pose_scores
from binpick_env.evaluation.pose.summary import summarise_poses
from binpick_env.jobs.workers import Workers, is_positive
from binpick_env.part_limits import check_part
from binpick_env.parts.part import Part
from binpick_env.parts.symmetry import SymmetrySettings
from policies.assessment.advice import advise
from policies.assessment.assessment import Assessment
from policies.assessment.config import PICKS, SCENES, AssessmentConfig
from policies.assessment.findings import Findings
from policies.assessment.grip import grip_facts
from policies.assessment.part import part_facts
from policies.assessment.perception import perception_facts
from policies.assessment.picking import picking_facts
from policies.assessment.resting import resting_poses
from policies.assessment.sight import bin_facts, sight_facts
from policies.evaluation.budget import Budget, budget_jobs, make_budget
from policies.evaluation.jobs import Job, run_job
from policies.evaluation.listeners import ListenerFactory
from policies.evaluation.records import BinRecord
from policies.evaluation.summary import summarise

Records = dict[Perception, list[BinRecord]]


class Progress:
    """What a caller learns while an assessment runs; this one says nothing."""

    def begin(self, stage: str, total: int) -> None:
        """Take note of a stage that begins.

        Args:
            stage: Name of the stage, in words.
            total: Number of steps that it has.
        """

    def advance(self) -> None:
        """Take note of a finished step."""

    def end(self) -> None:
        """Take note that the stage is over."""


@dataclass(frozen=True, kw_only=True)
class AssessmentJob:
    """How an assessment is carried out; nothing here changes what is measured, apart from wall clock.

    Attributes:
        out: Folder of the results; finished scenes and bins in it are not computed again.
        workers: Number of processes, or a cluster, each on one core.
        fresh: Whether scenes and bins are computed even if their records exist already.
        progress: Told of every stage and step.
        listeners: Makes the listeners that follow each bin that is picked from pixels, such as pictures; None for none.
    """

    out: Path
    workers: Workers = 2
    fresh: bool = False
    progress: Progress = field(default_factory=Progress)
    listeners: ListenerFactory | None = None

    def __post_init__(self) -> None:
        if not is_positive(self.workers):
            raise ValueError(f"workers must be at least 1, got {self.workers}")


@dataclass(frozen=True, eq=False, kw_only=True)
class AssessmentRun:
    """An assessment with the records that it was drawn from.

    Attributes:
        assessment: What was measured, and what to do.
        part: The part.
        scores: Score of each scene; empty if perception was not run.
        records: Records of the bins, by perception; empty if none was picked.
    """

    assessment: Assessment
    part: Part
    scores: Sequence[PoseSceneScore]
    records: Records


def assess(config: AssessmentConfig, job: AssessmentJob) -> AssessmentRun:
    """Assess a part: what it is, how it rests, is seen and held, and how well it is found and picked.

    A part that the jaw cannot hold is assessed for perception, and no bin is picked. A pile that does not come to rest
    leaves what is known of the part alone.

    Args:
        config: Part, cell and amount.
        job: Folder, processes and progress.

    Raises:
        ValueError: There is no such part, its file is unusable, or the folder holds results of another configuration.
        FileNotFoundError: The part's file does not exist.
        BinError: A bin failed.
        WorkerError: A worker process was killed; what is finished is kept.
    """
    clock = _Clock(job.progress)
    with clock.stage("part", 4):
        part = config.options.read_part()
        findings = describe(config, part, job.progress)
    scores: Sequence[PoseSceneScore] = ()
    records: Records = {}
    budget = None
    if (reason := _why_no_scene(config, part)) is not None:
        findings = replace(findings, not_perceived=reason, not_picked=reason)
    else:
        with clock.stage("scenes", config.scenes):
            try:
                findings, scores = _perceive(config, part, findings, job)
            except SettleError as error:
                findings = replace(findings, not_perceived=str(error), not_picked=str(error))
    if findings.grip.reason is not None:
        findings = replace(findings, not_picked=findings.grip.reason)
    if findings.not_picked is None:
        with clock.stage("bins", 3 * config.bins):
            budget, records = _pick(config, part, job)
        findings = replace(findings, picking=picking_facts(budget, records))
    assessment = Assessment(
        findings=findings, advice=advise(findings), budget=budget, seed=config.seed, seconds=clock.seconds
    )
    return AssessmentRun(assessment=assessment, part=part, scores=scores, records=records)


def describe(config: AssessmentConfig, part: Part, progress: Progress | None = None) -> Findings:
    """Return what is known of a part without any scene: what it is, how it rests, is seen and held.

    Args:
        config: Part, cell and amount.
        part: The same part, loaded.
        progress: Told of each of four steps; None tells nobody.
    """
    progress = progress or Progress()
    options = config.options
    detected = options.symmetry == "detect"
    facts = part_facts(part, SymmetrySettings(metres=options.symmetry_tolerance) if detected else None)
    progress.advance()
    rests = resting_poses(part.model)
    progress.advance()
    grip = grip_facts(part.model, rests, options.jaw)
    progress.advance()
    findings = Findings(
        options=options,
        part=facts,
        rests=rests,
        grip=grip,
        sight=sight_facts(options, part),
        bin=bin_facts(options, part, config.num_parts[0], config.parts_in_a_bin(part)),
    )
    progress.advance()
    return findings


class _Clock:
    """Measures stages and passes them on."""

    def __init__(self, progress: Progress) -> None:
        self.seconds: dict[str, float] = {}
        self._progress = progress

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[None]:
        start = time.perf_counter()
        self._progress.begin(name, total)
        try:
            yield
        finally:
            self._progress.end()
        self.seconds[name] = round(time.perf_counter() - start, 2)


def _why_no_scene(config: AssessmentConfig, part: Part) -> str | None:
    """Return why the cell refuses a part of this size; None if it takes it."""
    try:
        check_part(part, config.options.cell())
    except ValueError as error:
        return str(error)
    return None


def _perceive(
    config: AssessmentConfig, part: Part, findings: Findings, job: AssessmentJob
) -> tuple[Findings, Sequence[PoseSceneScore]]:
    """Evaluate segments and poses on fresh scenes."""
    evaluation, folder = config.perception(part), job.out / SCENES
    for _ in evaluate_poses(evaluation, config.scenes, folder, job.workers, fresh=job.fresh):
        job.progress.advance()
    scores = load_pose_scores(folder, config.scenes, part.model)
    rng = np.random.default_rng(config.seed)
    summary = summarise_poses(evaluation, scores, rng)
    return replace(findings, perception=perception_facts(summary, scores, rng)), scores


def _pick(config: AssessmentConfig, part: Part, job: AssessmentJob) -> tuple[Budget, Records]:
    """Pick the same bins with true poses, true segments and from pixels."""
    records: Records = {}
    modes = {}
    shared = Job(out=job.out / PICKS, bins=config.bins, workers=job.workers, fresh=job.fresh)
    for mode, (evaluation, each) in budget_jobs(config.picks(part), shared).items():
        listened = replace(each, listeners=job.listeners) if mode == "learned" else each
        records[mode] = run_job(evaluation, listened, on_bin=lambda _: job.progress.advance())
        modes[mode] = summarise(records[mode], evaluation, np.random.default_rng(config.seed))
    return make_budget(records, modes, np.random.default_rng(config.seed)), records
