"""Evaluate a segmentation method on generated scenes, with one record for each scene; runs can be resumed."""

import logging
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.evaluation.segmentation.method import MethodConfig, Segmenter, segmenter
from binpick_env.evaluation.segmentation.record import STAGES, SceneRecord, record_path
from binpick_env.jobs.folder_config import ensure_same_config
from binpick_env.jobs.process_map import map_indices
from binpick_env.jobs.workers import Workers, is_positive
from binpick_env.scenes.boundary_quality import wrong_side
from binpick_env.scenes.synthesis import OLDER_SETTINGS, SceneConfig, is_of_part, make_scene, scene_settings
from perception.boundary import BoundarySettings, extract_boundary
from perception.frame import Frame, Workspace
from perception.instance import Instance, labels_of
from perception.runtime.file_work import FolderWork
from perception.runtime.provenance import git_commit
from perception.runtime.records import RecordError
from perception.runtime.threads import use_threads
from perception.segmentation.scene import BoundaryScene
from perception.segmentation.surface import coarse_surface
from perception.segmentation.weights import load_record
from perception.thickness import part_boundary

_log = logging.getLogger(__name__)
CONFIG_FILE = "evaluation.json"


@dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """Configuration of an evaluation, on which all its numbers but the times depend.

    Attributes:
        scenes: Configuration of the scenes, which are generated in memory; no training may have used their seed.
        method: Method that is evaluated.
    """

    scenes: SceneConfig = field(default_factory=SceneConfig)
    method: MethodConfig

    def settings(self) -> dict[str, Any]:
        """Return all settings as a dict; files are represented by their SHA-256."""
        return {**scene_settings(self.scenes), "method": self.method.settings()}


def evaluate_scenes(
    config: EvaluationConfig,
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
        pictures: Whether to keep the grey images, two thirds of a record's size.

    Raises:
        ValueError: The folder holds another evaluation, there is no such part, the weights are damaged or were trained
            on these scenes, or ``count`` or ``workers`` is not positive.
        FileNotFoundError: The part's or the weights' file does not exist.
        WorkerError: A worker process was killed; every finished scene is kept.
    """
    if count < 1 or not is_positive(workers):
        raise ValueError(f"count and workers must be at least 1, got {count} and {workers}")
    config.scenes.options().load_part()
    segmenter(config.method)  # before the folder gets a configuration
    require_unseen(config)
    ensure_same_config(folder / CONFIG_FILE, config.settings(), "an evaluation", assumed=OLDER_SETTINGS)
    missing = []
    for index in range(count):
        if not fresh and _is_whole(record_path(folder, index)):
            yield index
        else:
            missing.append(index)
    threads = len(os.sched_getaffinity(0)) if workers == 1 else 1
    work = FolderWork(partial(_save_record, config, threads, pictures), folder)
    yield from map_indices(work, missing, workers)


def evaluate_scene(config: EvaluationConfig, index: int, threads: int = 1, picture: bool = True) -> SceneRecord:
    """Generate and segment scene ``index``; all but the times is independent of other scenes.

    Args:
        config: Configuration of the evaluation.
        index: Index of the scene.
        threads: Number of threads that torch and OpenCV may use.
        picture: Whether the record keeps the grey image.
    """
    scene, capture = make_scene(config.scenes, index)
    method, workspace = segmenter(config.method), config.scenes.cell().bin.workspace()
    settings = _boundary_settings(config.scenes.at(index))
    with use_threads(threads):
        if not method.warm:
            _segment(method, capture.frame, workspace, scene, settings)
            method.warm = True
        instances, ms = _segment(method, capture.frame, workspace, scene, settings)
    wrong, contour = wrong_side(capture, scene.boundary)
    u0, v0, u1, v1 = capture.region if picture else (0, 0, 0, 0)
    return SceneRecord(
        labels=labels_of(instances, len(scene.boundary)),
        scores=np.array([instance.score for instance in instances], np.float64),
        instance_ids=scene.instance_ids,
        visible_fractions=scene.visible_fractions,
        pixels=scene.boundary.pixels,
        picture=capture.frame.grey[v0:v1, u0:u1],
        corner=(u0, v0),
        wrong_side=wrong,
        contour=contour,
        ms=ms,
        threads=threads,
        git_commit=git_commit(),
    )


def require_unseen(config: EvaluationConfig) -> None:
    """Refuse scenes that the weights were trained or validated on, according to their record.

    Raises:
        ValueError: The weights were trained or validated on scenes of this part and seed.
    """
    if config.method.weights is None:
        return
    record = load_record(config.method.weights)
    for use in ("trained_on", "validated_on"):
        for source in record.get(use, []):
            if is_of_part(source, config.scenes) and source["seed"] == config.scenes.seed:
                raise ValueError(
                    f"{config.method.weights} has been {use.replace('_', ' ')} scenes of seed {config.scenes.seed}; "
                    "evaluate it with another seed"
                )


@lru_cache(maxsize=1)
def _boundary_settings(config: SceneConfig) -> BoundarySettings:
    return part_boundary(config.options().load_part().model)


def _segment(
    method: Segmenter, frame: Frame, workspace: Workspace, scene: BoundaryScene, settings: BoundarySettings
) -> tuple[list[Instance], dict[str, float]]:
    """Return the instances of a frame, and the time of each of `STAGES` [ms]."""
    clock = [time.perf_counter()]
    boundary = extract_boundary(frame, workspace, settings)
    clock.append(time.perf_counter())
    surface = coarse_surface(frame, workspace, scene.d_max)
    clock.append(time.perf_counter())
    instances = method.segment(boundary, surface, scene.d_max, scene.shape)
    clock.append(time.perf_counter())
    seconds = [*np.diff(clock), clock[-1] - clock[0]]
    return instances, {name: 1000 * float(value) for name, value in zip(STAGES, seconds, strict=True)}


def _save_record(config: EvaluationConfig, threads: int, picture: bool, folder: Path, index: int) -> int:
    evaluate_scene(config, index, threads, picture).save(record_path(folder, index))
    return index


def _is_whole(path: Path) -> bool:
    if not path.exists():
        return False
    try:
        SceneRecord.load(path)
    except RecordError as error:
        _log.warning("evaluated again: %s", error)
        return False
    return True
