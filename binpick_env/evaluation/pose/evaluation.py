"""Evaluate a pose estimation method on generated scenes, with one record for each scene; runs can be resumed."""

import logging
import os
import time
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.evaluation.pose.method import PoseMethod, PoseMethodConfig, pose_method
from binpick_env.evaluation.pose.record import DOUBT_COLUMNS, STAGES, TRIALS, VERDICT, VERDICT_COLUMNS, PoseRecord
from binpick_env.evaluation.segmentation.evaluation import EvaluationConfig, require_unseen
from binpick_env.evaluation.segmentation.record import record_path
from binpick_env.jobs.folder_config import ensure_same_config
from binpick_env.jobs.process_map import map_indices
from binpick_env.jobs.workers import Workers, is_positive
from binpick_env.scenes.synthesis import OLDER_SETTINGS, CapturedScene, SceneConfig, make_scene, scene_settings
from binpick_env.scenes.whole_part import whole_part_points
from perception.boundary import BoundaryCloud, extract_boundary
from perception.diagnosis import PoseCounts, diagnose
from perception.frame import Frame
from perception.geometry import Floats
from perception.instance import Instance, labels_of
from perception.pose.candidates import nearest_groups
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.selection.explanation import explain_segments
from perception.runtime.file_work import FolderWork
from perception.runtime.provenance import git_commit
from perception.runtime.records import RecordError
from perception.runtime.threads import use_threads
from perception.segmentation.surface import coarse_surface
from perception.thickness import part_boundary

_log = logging.getLogger(__name__)
CONFIG_FILE = "pose_evaluation.json"
RENAMED = {  # names of settings in the previous version's files
    "method.estimator.confidence.firmness": "method.estimator.confidence.score_drop",
    **{f"method.estimator.twins.{x}": f"method.estimator.near_symmetry.{x}" for x in ("most", "distance", "lead")},
}


@dataclass(frozen=True, kw_only=True)
class PoseEvaluationConfig:
    """Configuration of an evaluation, on which all its numbers but the times depend.

    Attributes:
        scenes: Configuration of the scenes, which are generated in memory; no training may have used their seed.
        method: Method that is evaluated.
    """

    scenes: SceneConfig = field(default_factory=SceneConfig)
    method: PoseMethodConfig = field(default_factory=PoseMethodConfig)

    def settings(self) -> dict[str, Any]:
        """Return all settings as a dict; files are represented by their SHA-256."""
        return {**scene_settings(self.scenes), "method": self.method.settings()}

    def plain(self) -> dict[str, Any]:
        """Return the settings as results hold them: renamed ones have their previous names, too, for one version."""
        plain = deepcopy(self.settings())
        values = _flat(plain)
        for previous, present in RENAMED.items():
            *groups, name = previous.split(".")
            group = plain
            for each in groups:
                group = group.setdefault(each, {})
            group[name] = values[present]
        return plain

    def load(self) -> PoseMethod:
        """Return the method with the models of the part in the bins."""
        return pose_method(self.method, self.scenes.options())

    def whole_part_points(self) -> float:
        """Return P, the number of boundary points of a whole part, times its depth [m]."""
        return whole_part_points(self.scenes.part, self.scenes.unit, self.scenes.camera)


@dataclass(frozen=True, eq=False, kw_only=True)
class _FrameResult:
    """Groups and poses of a frame.

    Attributes:
        instances: Groups of points; the true segments where the whole scene was searched.
        trials: Indices of the groups that are recognition trials.
        estimates: Estimated poses, verified or not.
        verified: Whether each estimate passes verification.
        explained: Groups of points after explanation by the poses.
        ms: Wall clock of each of `STAGES` [ms].
        causes: Names of the likely causes of lost parts.
    """

    instances: list[Instance]
    trials: list[int]
    estimates: list[PoseEstimate]
    verified: list[bool]
    explained: list[Instance]
    ms: dict[str, float]
    causes: tuple[str, ...]


def evaluate_poses(
    config: PoseEvaluationConfig,
    count: int,
    folder: Path,
    workers: Workers = 1,
    *,
    fresh: bool = False,
    pictures: bool = True,
) -> Iterator[int]:
    """Write the records of scenes 0 to ``count - 1`` and yield each index once its record exists.

    Args:
        config: Configuration of the evaluation.
        count: Number of scenes; a later run may ask for more.
        folder: Folder of the records; intact records are kept.
        workers: Number of worker processes, or a cluster, each on one core. With 1 this process computes, on all cores.
        fresh: Whether to compute the records that exist again.
        pictures: Whether to keep the grey images.

    Raises:
        ValueError: The folder holds another evaluation, there is no such part, the weights are damaged or were trained
            on these scenes, or ``count`` or ``workers`` is not positive.
        FileNotFoundError: The part's or the weights' file does not exist.
        WorkerError: A worker process was killed; every finished scene is kept.
    """
    if count < 1 or not is_positive(workers):
        raise ValueError(f"count and workers must be at least 1, got {count} and {workers}")
    config.load()  # before the folder gets a configuration
    if config.method.network is not None:
        require_unseen(EvaluationConfig(scenes=config.scenes, method=config.method.network))
    ensure_same_config(
        folder / CONFIG_FILE, _flat(config.settings()), "an evaluation of poses", RENAMED, assumed=OLDER_SETTINGS
    )
    missing = []
    for index in range(count):
        if not fresh and _is_whole(record_path(folder, index)):
            yield index
        else:
            missing.append(index)
    if missing:
        config.whole_part_points()  # cached on disk, where the workers find it
    threads = len(os.sched_getaffinity(0)) if workers == 1 else 1
    work = FolderWork(partial(_save_record, config, threads, pictures), folder)
    yield from map_indices(work, missing, workers)


def evaluate_pose_scene(config: PoseEvaluationConfig, index: int, threads: int = 1, picture: bool = True) -> PoseRecord:
    """Generate scene ``index`` and estimate its poses.

    Args:
        config: Configuration of the evaluation.
        index: Index of the scene.
        threads: Number of threads that torch and OpenCV may use.
        picture: Whether the record keeps the grey image.
    """
    captured = make_scene(config.scenes, index)
    method = config.load()
    with use_threads(threads):
        if not method.warm:
            _process_frame(config, method, captured)
            method.warm = True
        result = _process_frame(config, method, captured)
    scene, frame = captured.scene, captured.capture.frame
    u0, v0, u1, v1 = captured.capture.region if picture else (0, 0, 0, 0)
    estimates, groups = result.estimates, len(result.instances)
    return PoseRecord(
        labels=labels_of(result.instances, len(scene.boundary)),
        confidences=np.array([instance.score for instance in result.instances], np.float64),
        explained=labels_of(result.explained, len(scene.boundary)),
        explained_confidences=np.array([instance.score for instance in result.explained], np.float64),
        instance_ids=scene.instance_ids,
        visible_fractions=scene.visible_fractions,
        T_cam_parts=scene.T_cam_parts,
        trials=np.array(result.trials, np.int64),
        poses=np.array([estimate.T_cam_part for estimate in estimates], np.float64).reshape(-1, 4, 4),
        scores=np.array([estimate.score for estimate in estimates], np.float64),
        groups=np.array([e.instance_idx if e.instance_idx < groups else -1 for e in estimates], np.int64),
        estimated_fractions=np.array([estimate.visible_fraction for estimate in estimates], np.float64),
        verdicts=_verdicts(estimates),
        doubts=_doubts(estimates),
        verified=np.array(result.verified, np.bool_),
        pixels=scene.boundary.pixels,
        picture=frame.grey[v0:v1, u0:u1],
        corner=(u0, v0),
        K=frame.K,
        whole_scene=not method.by_group,
        ms=result.ms,
        threads=threads,
        git_commit=git_commit(),
        causes=result.causes,
    )


def _process_frame(config: PoseEvaluationConfig, method: PoseMethod, captured: CapturedScene) -> _FrameResult:
    """Segment a frame and estimate its poses, and measure the time of each stage."""
    frame, workspace = captured.capture.frame, config.scenes.cell().bin.workspace()
    clock = [time.perf_counter()]
    boundary = extract_boundary(frame, workspace, part_boundary(method.part))
    clock.append(time.perf_counter())
    surface = coarse_surface(frame, workspace, method.part.d_max) if method.needs_surface else None
    clock.append(time.perf_counter())
    instances = method.segments(boundary, surface, captured.scene)
    clock.append(time.perf_counter())
    estimates, verified = _poses(method, boundary, instances, frame)
    clock.append(time.perf_counter())
    groups = instances if method.by_group else []
    explained = explain_segments(boundary, groups, estimates, method.estimator.surface, method.config.explanation)
    clock.append(time.perf_counter())
    spent = 1000 * np.diff(clock)
    if not method.needs_surface:  # true segments take no time
        spent[1:3] = 0.0
    trials = _trials(config, boundary, instances)
    alone = _trial_ms(method, boundary, [instances[k] for k in trials], frame)
    *stages, explanation = spent.tolist()
    ms = dict(zip(STAGES, [*stages, alone, explanation, sum(stages)], strict=True))
    counts = _count_poses(method, len(groups), estimates, verified)
    report = diagnose(frame, workspace, method.part, boundary, counts)
    return _FrameResult(
        instances=instances,
        trials=trials,
        estimates=estimates,
        verified=verified,
        explained=explained,
        ms=ms,
        causes=tuple(cause.name for cause in report.causes),
    )


def _count_poses(
    method: PoseMethod, groups: int, estimates: Sequence[PoseEstimate], verified: Sequence[bool]
) -> PoseCounts:
    """Count what became of the groups, as far as their best poses tell; hypotheses that the bin rejected do not."""
    least = method.config.estimator.min_score
    low = sum(not ok and each.score < least for each, ok in zip(estimates, verified, strict=True))
    found, total = sum(verified), max(groups, len(estimates))
    return PoseCounts(
        groups=total,
        found=found,
        by_score=low,
        by_neighbours=len(estimates) - found - low,
        without_pose=total - len(estimates),
    )


def _poses(
    method: PoseMethod, boundary: BoundaryCloud, instances: Sequence[Instance], frame: Frame
) -> tuple[list[PoseEstimate], list[bool]]:
    """Return all poses of a scene, and whether each passes verification."""
    if not method.by_group:
        poses = method.estimator.estimate_scene(boundary, frame)
        return poses, [True] * len(poses)
    estimates = method.estimator.estimate_groups(boundary, instances, frame)
    _, more = method.estimator.estimate_leftovers(boundary, instances, estimates, frame)
    estimates = [*estimates, *more]
    verified_groups = {estimate.instance_idx for estimate in method.estimator.verified(estimates)}
    found = [estimate for estimate in estimates if estimate is not None]
    return found, [estimate.instance_idx in verified_groups for estimate in found]


def _trials(config: PoseEvaluationConfig, boundary: BoundaryCloud, instances: Sequence[Instance]) -> list[int]:
    """Return the recognition trials: the groups whose number of points is nearest to that of a whole part."""
    if not instances:
        return []
    expected = config.whole_part_points() / float(np.median(boundary.points_cam[:, 2]))
    return nearest_groups([len(instance.point_idx) for instance in instances], max(round(expected), 1), count=TRIALS)


def _trial_ms(method: PoseMethod, boundary: BoundaryCloud, chosen: Sequence[Instance], frame: Frame) -> float:
    """Return the time of the poses of these groups alone [ms]; NaN where the whole scene is searched."""
    if not method.by_group or not chosen:
        return np.nan
    start = time.perf_counter()
    method.estimator.estimate_groups(boundary, chosen, frame)
    return 1000 * (time.perf_counter() - start)


def _verdicts(estimates: Sequence[PoseEstimate]) -> Floats:
    rows = [[*(getattr(e.verdict, name) for name in VERDICT), e.margin, e.score_drop, e.size] for e in estimates]
    return np.array(rows, np.float64).reshape(-1, len(VERDICT_COLUMNS))


def _doubts(estimates: Sequence[PoseEstimate]) -> Floats:
    rows = [[e.mismatch.patch, e.mismatch.stray, e.noise, e.expected_error.rotation] for e in estimates]
    return np.array(rows, np.float64).reshape(-1, len(DOUBT_COLUMNS))


def _save_record(config: PoseEvaluationConfig, threads: int, picture: bool, folder: Path, index: int) -> int:
    evaluate_pose_scene(config, index, threads, picture).save(record_path(folder, index))
    return index


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested settings with dotted names, so that the message on a difference names the setting."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat


def _is_whole(path: Path) -> bool:
    if not path.exists():
        return False
    try:
        PoseRecord.load(path)
    except RecordError as error:
        _log.warning("evaluated again: %s", error)
        return False
    return True
