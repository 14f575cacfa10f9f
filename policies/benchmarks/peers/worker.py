"""The peer's side of `policies.benchmarks.pose_peers`, which runs in the peer's environment and needs only numpy.

A method is a file with ``version() -> str`` and ``build(model, d_max, threads, setting) -> estimate``, where
``estimate(points, top)`` returns (H, 4, 4) poses ``T_cam_part``, the best first, and their (H,) scores. Model (M, 6)
and points (N, 6) are float64 positions [m] with unit normals.
"""

import os
import runpy
import time
from typing import Any

import numpy as np


def serve(method_file: str, inputs: str, answers: str, threads: str, repeats: str, setting: str) -> None:
    """Run the method on each case ``repeats`` times after one warm-up, and write its poses and times.

    Args:
        method_file: Path of the method.
        inputs: Path of an ``.npz`` with ``model``, ``d_max``, ``tops`` (C,), and the points of case k as ``case_k``.
        answers: Path of the ``.npz`` to write: ``version``, ``build_s``, ``ms`` and ``cpu_ms`` (R, C), numbers of poses
            ``counts`` (R, C), and all ``poses`` (sum of counts, 4, 4) and ``scores``, concatenated.
        threads: Number of threads that may be used.
        repeats: Number of runs on each case, R.
        setting: Text that is passed to the method.
    """
    pin(int(threads))
    method = runpy.run_path(method_file)
    with np.load(inputs) as stored:
        cases = [(stored[f"case_{k}"], int(top)) for k, top in enumerate(stored["tops"])]
        start = time.perf_counter()
        estimate = method["build"](stored["model"], float(stored["d_max"]), int(threads), setting)
        build_s = time.perf_counter() - start
    estimate(*cases[0])
    found = [[_timed(estimate, *case) for case in cases] for _ in range(int(repeats))]
    flat = [answer for row in found for answer in row]
    np.savez(
        answers,
        version=method["version"](),
        build_s=build_s,
        ms=[[answer[2] for answer in row] for row in found],
        cpu_ms=[[answer[3] for answer in row] for row in found],
        counts=[[len(answer[0]) for answer in row] for row in found],
        poses=np.concatenate([answer[0] for answer in flat]),
        scores=np.concatenate([answer[1] for answer in flat]),
    )


def pin(threads: int) -> None:
    """Pin this process to ``threads`` cores, since not every library's number of threads can be set."""
    if hasattr(os, "sched_setaffinity"):  # Linux
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:threads])


def _timed(estimate: Any, points: Any, top: int) -> tuple[Any, Any, float, float]:
    """Return poses, scores, wall clock time and processor time [ms]."""
    wall, cpu = time.perf_counter(), time.process_time()
    poses, scores = estimate(points, top)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return np.reshape(poses, (-1, 4, 4)).astype(float), np.reshape(scores, -1).astype(float), 1000 * wall, 1000 * cpu
