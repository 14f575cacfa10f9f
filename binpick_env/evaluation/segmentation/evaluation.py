"""Segmentation judged on fresh scenes: a map of a pure function over indices, resumable, one file a scene."""

import logging
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.config import CellConfig
from binpick_env.evaluation.segmentation.method import MethodConfig, Segmenter, segmenter
from binpick_env.evaluation.segmentation.record import STAGES, SceneRecord, record_path
from binpick_env.jobs.folder_config import ensure_same_config
from binpick_env.jobs.process_map import map_indices
from binpick_env.parts import load_part
from binpick_env.scenes.boundary_quality import wrong_side
from binpick_env.scenes.synthesis import SceneConfig, make_scene, scene_settings
from perception.boundary import extract_boundary
from perception.frame import Frame
from perception.instance import Instance, labels_of
from perception.runtime.provenance import git_commit
from perception.runtime.records import RecordError
from perception.runtime.threads import use_threads
from perception.segmentation.surface import coarse_surface
from perception.segmentation.weights import load_record

_log = logging.getLogger(__name__)
CONFIG_FILE = "evaluation.json"


@dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """What an evaluation's numbers depend on, wall clock aside.

    Attributes:
        scenes: Made anew in memory; their seed must not be a training's.
        method: What is judged.
    """

    scenes: SceneConfig = field(default_factory=SceneConfig)
    method: MethodConfig

    def settings(self) -> dict[str, Any]:
        """Return all settings as plain values, the contents of files by their hash."""
        return {**scene_settings(self.scenes), "method": self.method.settings()}


def evaluate_scenes(
    config: EvaluationConfig,
    count: int,
    folder: Path,
    workers: int = 1,
    *,
    fresh: bool = False,
    pictures: bool = True,
) -> Iterator[int]:
    """Keep the records of scenes 0 to ``count - 1`` and yield each index as it is there.

    Args:
        config: What the records depend on.
        count: How many; more may be asked for later.
        folder: Where they are kept; whole ones that lie there are not computed again.
        workers: Processes, each computing on one core; 1 computes in this one, on all cores.
        fresh: Compute those that lie there, too.
        pictures: Whether to keep the grey images, two thirds of a record.

    Raises:
        ValueError: The folder is another evaluation's, there is no such part, the weights are damaged or have seen
            these scenes, or nothing is asked for.
        FileNotFoundError: The part's or the weights' file does not exist.
        WorkerError: A process was killed; every finished scene is kept.
    """
    if count < 1 or workers < 1:
        raise ValueError(f"count and workers must be at least 1, got {count} and {workers}")
    load_part(config.scenes.part, unit=config.scenes.unit)
    segmenter(config.method)  # what cannot be loaded must not claim the folder
    require_unseen(config)
    ensure_same_config(folder / CONFIG_FILE, config.settings(), "an evaluation")
    missing = []
    for index in range(count):
        if not fresh and _is_whole(record_path(folder, index)):
            yield index
        else:
            missing.append(index)
    threads = 1 if workers > 1 else len(os.sched_getaffinity(0))
    yield from map_indices(partial(_keep_scene, config, folder, threads, pictures), missing, workers)


def evaluate_scene(config: EvaluationConfig, index: int, threads: int = 1, picture: bool = True) -> SceneRecord:
    """Make scene ``index``, segment it and keep what has to be known: the same whatever was evaluated before.

    Args:
        config: What the record depends on.
        index: Of the scene.
        threads: That torch and OpenCV may use.
        picture: Whether to keep the grey image.
    """
    scene, capture = make_scene(config.scenes, index)
    method = segmenter(config.method)
    with use_threads(threads):
        if not method.warm:
            _segment(method, capture.frame, scene.d_max)
            method.warm = True
        instances, ms = _segment(method, capture.frame, scene.d_max)
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
    """Refuse scenes that the weights were trained or chosen on, as far as their record says so."""
    if config.method.weights is None:
        return
    record = load_record(config.method.weights)
    for use in ("trained_on", "validated_on"):
        for source in record.get(use, []):
            same_part = Path(str(source["part"])).stem == Path(config.scenes.part).stem
            if same_part and source["seed"] == config.scenes.seed:
                raise ValueError(
                    f"{config.method.weights} has been {use.replace('_', ' ')} scenes of seed {config.scenes.seed}; "
                    "judge it with another seed"
                )


def _segment(method: Segmenter, frame: Frame, d_max: float) -> tuple[list[Instance], dict[str, float]]:
    """Return a frame's instances, and what each of `STAGES` took [ms]."""
    workspace = CellConfig().bin.workspace()
    clock = [time.perf_counter()]
    boundary = extract_boundary(frame, workspace)
    clock.append(time.perf_counter())
    surface = coarse_surface(frame, workspace, d_max)
    clock.append(time.perf_counter())
    instances = method.segment(boundary, surface, d_max)
    clock.append(time.perf_counter())
    spent = [*np.diff(clock), clock[-1] - clock[0]]
    return instances, {name: 1000 * float(seconds) for name, seconds in zip(STAGES, spent, strict=True)}


def _keep_scene(config: EvaluationConfig, folder: Path, threads: int, picture: bool, index: int) -> int:
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
