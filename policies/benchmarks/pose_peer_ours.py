"""Our own pose estimation, timed as the peers are: in its own process, pinned to as many cores as it may use."""

import multiprocessing
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager

import cv2
import numpy as np

from binpick_env.options import CellOptions
from perception.pose.estimator import PoseEstimator
from perception.pose.pose_estimate import PoseEstimate
from policies.benchmarks.peers.worker import pin
from policies.benchmarks.pose_peer_inputs import PoseCase, SceneInput
from policies.benchmarks.pose_peers import Answers, thread_variables


def run_ours(options: CellOptions, scenes: Sequence[SceneInput], cases: Sequence[PoseCase], threads: int) -> Answers:
    """Run `PoseEstimator` on the cases in a new process.

    Args:
        options: The part.
        scenes: Scenes that the cases refer to.
        cases: Searches, at least one.
        threads: Number of threads that the process may use.

    Raises:
        ValueError: There is no case.
    """
    if not cases:
        raise ValueError("our method needs at least one case, got none")
    with _variables(thread_variables(threads)):
        executor = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))
        with executor:
            return executor.submit(_answer, options, scenes, cases, threads).result()


def _answer(options: CellOptions, scenes: Sequence[SceneInput], cases: Sequence[PoseCase], threads: int) -> Answers:
    pin(threads)
    cv2.setNumThreads(threads)
    start = time.perf_counter()
    estimator = PoseEstimator(options.load_part().model)
    return answer(estimator, scenes, cases, time.perf_counter() - start)


def answer(
    estimator: PoseEstimator, scenes: Sequence[SceneInput], cases: Sequence[PoseCase], build_s: float
) -> Answers:
    """Estimate poses in each case once, after a warm-up with one case of each kind.

    Args:
        estimator: Estimator of the part.
        scenes: Scenes that the cases refer to.
        cases: Searches, at least one.
        build_s: Time of building the estimator [s].
    """
    for kind in (True, False):
        for case in [case for case in cases if (case.instance is None) == kind][:1]:
            _estimates(estimator, scenes[case.scene], case)
    found, wall, cpu = [], [], []
    for case in cases:
        clock = time.perf_counter(), time.process_time()
        found.append(_estimates(estimator, scenes[case.scene], case))
        wall.append(1000 * (time.perf_counter() - clock[0]))
        cpu.append(1000 * (time.process_time() - clock[1]))
    return Answers(
        version="binpick",
        build_s=build_s,
        ms=np.array([wall]),
        cpu_ms=np.array([cpu]),
        poses=[[np.reshape([e.T_cam_part for e in row], (-1, 4, 4)) for row in found]],
        scores=[[np.array([e.score for e in row], np.float64) for row in found]],
    )


def _estimates(estimator: PoseEstimator, scene: SceneInput, case: PoseCase) -> list[PoseEstimate]:
    if case.instance is None:
        return estimator.estimate_scene(scene.boundary, scene.frame)[: case.top]
    poses = estimator.estimate_groups(scene.boundary, [case.instance], scene.frame)
    return [pose for pose in poses if pose is not None]


@contextmanager
def _variables(values: dict[str, str]) -> Iterator[None]:
    """Set environment variables for processes that are started inside the context."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
