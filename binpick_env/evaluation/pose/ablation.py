"""Ablation of the pose estimation: variants of the method on the same scenes and the same true segments."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from binpick_env.evaluation.pose.evaluation import PoseEvaluationConfig, evaluate_poses
from binpick_env.evaluation.pose.method import PoseMethodConfig
from binpick_env.evaluation.pose.scene_score import PoseSceneScore, load_pose_scores
from binpick_env.evaluation.pose.statistics import (
    METHODS,
    bootstrap_weights,
    ms_per_group,
    pose_counts,
    pose_intervals,
    quotient,
    resampled_quotients,
)
from binpick_env.evaluation.pose.summary import NOTE
from binpick_env.jobs.folder_config import ensure_same_config
from binpick_env.jobs.workers import Workers
from binpick_env.scenes.synthesis import OLDER_SETTINGS, SceneConfig, scene_settings
from perception.geometry import Floats
from perception.metrics.average_precision import percentile_interval
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.model.viewpoints import VIEW_COUNTS
from perception.pose.selection.bodies import BodyConfig
from perception.runtime.provenance import command_line, git_commit, versions

METRICS = ("recognition_rate", "recall", "precision")
RESAMPLES = 1000  # bootstrap resamples
ANYWHERE = BodyConfig(overlap=0.999, protrusion=0.999)  # limits that no pose exceeds: collisions do not count
Report = Callable[[str], object]


@dataclass(frozen=True, kw_only=True)
class PoseRow:
    """A row of the table.

    Attributes:
        key: Name of the folder of the row's records; rows of the same key share one computation.
        name: Name of the row in the printed table.
        method: Variant of the method.
        verified: Whether only verified poses count.
    """

    key: str
    name: str
    method: PoseMethodConfig
    verified: bool = True


@dataclass(frozen=True, kw_only=True)
class PoseRowResult:
    """Numbers of a row.

    Attributes:
        name: Name of the row in the printed table.
        recognition_rate: Share of the trials that are recognised.
        trials: Number of trials.
        recall: Share of the parts with a visible fraction of at least 0.5 that have a correct pose.
        precision: Share of the counted poses that are correct.
        delivered: Number of counted poses: the verified ones, or all of them.
        intervals: 95 % intervals of recognition rate, recall and precision.
        against_full: Differences to the first row, (value, low, high), with the ends of a 95 % percentile bootstrap
            over the same scenes; None in the first row.
        ms_per_group: Median time of the pose of one group [ms]; NaN without groups.
        ms_pose: Median time of all poses of a scene [ms].
    """

    name: str
    recognition_rate: float
    trials: int
    recall: float
    precision: float
    delivered: int
    intervals: dict[str, tuple[float, float]]
    against_full: dict[str, tuple[float, float, float]] | None
    ms_per_group: float
    ms_pose: float


@dataclass(frozen=True, kw_only=True)
class PoseAblation:
    """All rows of an ablation.

    Attributes:
        rows: Rows of the table, the full method first.
        scenes: Number of scenes that every row was evaluated on.
        threads: Numbers of threads that scenes were computed on.
        part: Part in the bins.
        sensor: Preset of the depth sensor's noise.
        seed: Seed of the scenes.
        interval_methods: Method of each interval.
        note: How far these numbers and the paper's can be compared.
        command: Command line of the process that made the table.
        git_commits: Commits of the code that made the records and the table.
        versions: Versions of Python, platform and packages.
    """

    rows: list[PoseRowResult]
    scenes: int
    threads: list[int]
    part: str
    sensor: str
    seed: int
    interval_methods: dict[str, str] = field(default_factory=lambda: {name: METHODS[name] for name in METRICS})
    note: str = NOTE
    command: str = field(default_factory=command_line)
    git_commits: list[str]
    versions: dict[str, str] = field(default_factory=versions)


def pose_rows(full: EstimatorConfig | None = None) -> list[PoseRow]:
    """Return the rows: the full method, then variants that each differ from it in one setting."""
    full = full or EstimatorConfig()

    def row(key: str, name: str, estimator: EstimatorConfig = full, **changes: Any) -> PoseRow:
        return PoseRow(key=key, name=name, method=PoseMethodConfig(estimator=estimator), **changes)

    views = [
        row(f"views-{count}", f"{count} view{'s' * (count > 1)}", replace(full, edges=replace(full.edges, views=count)))
        for count in VIEW_COUNTS
        if count != full.edges.views
    ]
    naive: tuple[tuple[Literal["no_flip", "raw"], str], ...] = (
        ("no_flip", "tangents taken to point the same way"),
        ("raw", "tangents' signs taken as they come"),
    )
    signs = [row(f"signs-{kind}", name, replace(full, pairs=replace(full.pairs, signs=kind))) for kind, name in naive]
    return [
        row("full", f"full method, {full.edges.views} views"),
        row("pairs", "pairs of edges never seen together", replace(full, pairs=replace(full.pairs, same_view=False))),
        *views,
        *signs,
        row("spread", "look-ups not spread over noise", replace(full, pairs=replace(full.pairs, angle_noise=0.0))),
        row("alone", "bin and neighbours do not matter", replace(full, bodies=ANYWHERE)),
        row("full", "without verification", verified=False),
        replace(
            row("whole-scene", "whole scene, no segments"),
            method=PoseMethodConfig(perception="whole_scene", estimator=full),
        ),
    ]


@dataclass(frozen=True, kw_only=True)
class PoseAblationConfig:
    """What the table depends on.

    Attributes:
        scenes: Part, bin, sensor and seed of the scenes that every row is evaluated on.
        count: Number of scenes; a later run may ask for more.
        rows: Rows of the table; the others are compared with the first.
    """

    scenes: SceneConfig
    count: int = 100
    rows: Sequence[PoseRow] = field(default_factory=pose_rows)


def run_pose_ablation(
    config: PoseAblationConfig, out: Path, workers: Workers = 1, *, fresh: bool = False, report: Report | None = None
) -> PoseAblation:
    """Evaluate every row and tabulate; results that ``out`` holds already are reused.

    Args:
        config: Scenes and rows of the table.
        out: Folder of the rows' records.
        workers: Number of worker processes, or a cluster.
        fresh: Whether to compute the records that exist again.
        report: Function that is called with a line of text after each scene.

    Raises:
        ValueError: The folder holds another ablation, or there is no such part.
        WorkerError: A process was killed; every finished scene is kept.
    """
    scenes, count = config.scenes, config.count
    scores: dict[str, list[PoseSceneScore]] = {}
    for row in config.rows:
        evaluation = PoseEvaluationConfig(scenes=scenes, method=row.method)
        part = evaluation.load().part  # a part that cannot be loaded must not bind the folder
        ensure_same_config(
            out / "pose_ablation.json", scene_settings(scenes), "an ablation of poses", assumed=OLDER_SETTINGS
        )
        if row.key in scores:
            continue
        folder = out / "rows" / row.key
        for k, _ in enumerate(evaluate_poses(evaluation, count, folder, workers, fresh=fresh, pictures=False)):
            if report is not None:
                report(f"{row.name}: scene {k + 1} of {count}")
        scores[row.key] = load_pose_scores(folder, count, part)
    return tabulate_poses([(row, scores[row.key]) for row in config.rows], scenes, np.random.default_rng(scenes.seed))


def tabulate_poses(
    rows: Sequence[tuple[PoseRow, Sequence[PoseSceneScore]]],
    scenes: SceneConfig,
    rng: np.random.Generator,
    resamples: int = RESAMPLES,
) -> PoseAblation:
    """Tabulate rows that were evaluated on the same scenes.

    Args:
        rows: Each row of the table with the scores of all scenes.
        scenes: Configuration of the scenes.
        rng: Random generator of the bootstrap.
        resamples: Number of bootstrap resamples; all rows share the drawn scenes.

    Raises:
        ValueError: There is no row, or the rows are of different scenes.
    """
    if not rows or not rows[0][1]:
        raise ValueError("there is nothing to tabulate: no row, or no scene")
    first = [score.index for score in rows[0][1]]
    for row, scores in rows:
        if [score.index for score in scores] != first:
            raise ValueError(f"all rows must be of the same scenes, {row.name!r} is of others")
    weights = bootstrap_weights(len(first), rng, resamples)
    full = pose_counts(rows[0][1], rows[0][0].verified)
    results = [_result(row, scores, weights, None if k == 0 else full) for k, (row, scores) in enumerate(rows)]
    every = [score for _, scores in rows for score in scores]
    return PoseAblation(
        rows=results,
        scenes=len(first),
        threads=sorted({score.threads for score in every}),
        part=scenes.part,
        sensor=scenes.sensor,
        seed=scenes.seed,
        git_commits=sorted({score.git_commit for score in every} | {git_commit()}),
    )


def _result(row: PoseRow, scores: Sequence[PoseSceneScore], weights: Floats, full: Floats | None) -> PoseRowResult:
    counts = pose_counts(scores, row.verified)
    sums = counts.sum(axis=0)
    return PoseRowResult(
        name=row.name,
        recognition_rate=quotient(sums[0], sums[1]),
        trials=int(sums[1]),
        recall=quotient(sums[2], sums[3]),
        precision=quotient(sums[4], sums[5]),
        delivered=int(sums[5]),
        intervals=pose_intervals(counts, weights),
        against_full=None if full is None else _differences(counts, full, weights),
        ms_per_group=ms_per_group(scores),
        ms_pose=float(np.median([score.ms["pose"] for score in scores])),
    )


def _differences(counts: Floats, full: Floats, weights: Floats) -> dict[str, tuple[float, float, float]]:
    ones = np.ones((1, len(counts)))
    value = (resampled_quotients(counts, ones) - resampled_quotients(full, ones))[0]
    drawn = resampled_quotients(counts, weights) - resampled_quotients(full, weights)
    return {name: (float(value[k]), *percentile_interval(drawn[:, k])) for k, name in enumerate(METRICS)}
