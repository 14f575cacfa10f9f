"""Pose estimation compared with other libraries on the same inputs: recognition rates and times.

Inputs are true segments, and whole bins, in which the pose of any part is right. On a segment the peers are given
every pixel of the true part with its depth and a normal, which is more than any segmentation would give them; the time
of computing normals is not counted. A pose is right by the paper's criterion: 10 % of d_max at the part's centre and
5 degrees modulo symmetry.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from binpick_env.jobs.text_tables import columns, number, percent
from binpick_env.scenes.synthesis import SceneConfig
from perception.geometry import Floats
from perception.metrics.pose_errors import recognition_distances
from perception.metrics.pose_recognition import judge_poses
from perception.part import PartModel
from policies.benchmarks.measurement import Measurement
from policies.benchmarks.pose_peer_inputs import PoseCase, model_points, pose_cases
from policies.benchmarks.pose_peer_ours import run_ours
from policies.benchmarks.pose_peers import PEERS, Answers, Peer, available, run_peer
from policies.evaluation.statistics import rate

OURS = "ours: PPF-MEAM"
THREADS = (1, 2)
SEGMENTS, WHOLE = "true segments", "whole bins"


@dataclass(frozen=True, kw_only=True)
class PoseRow(Measurement):
    """Times of one method on one kind of input [ms], and how often its best pose was right.

    Attributes:
        inputs: Kind of input, `SEGMENTS` or `WHOLE`.
        method: Name of the method.
        version: Version of the method.
        threads: Number of threads that the method may use.
        build_s: Time of building the method's models [s].
        cpu_ms: Processor time, summed over processors, for each of the values [ms].
        trials: Number of cases.
        right: Number of cases in which the best pose was right, for each repeat.
        found: Number of instances found by all poses together, in the first repeat.
        to_find: Number of instances that have to be found.
    """

    inputs: str
    method: str
    version: str
    threads: int
    build_s: float
    cpu_ms: tuple[float, ...]
    trials: int
    right: tuple[int, ...]
    found: int
    to_find: int

    @property
    def typical(self) -> int:
        """Number of cases in which the best pose was right, in the median repeat."""
        return sorted(self.right)[len(self.right) // 2]


def bench_pose(
    config: SceneConfig,
    count: int,
    whole_scenes: int,
    interpreters: Mapping[str, Path | None],
    peers: Sequence[Peer] = PEERS,
) -> Iterator[PoseRow]:
    """Measure our method and every peer that has an interpreter, with one thread and with two.

    Args:
        config: Part and its scenes.
        count: Number of scenes, each of three segments.
        whole_scenes: Number of scenes that are also searched as a whole.
        interpreters: Python interpreter of each family of peers; families without one are left out, with a warning.
        peers: Methods that are compared with ours.

    Yields:
        The rows of each method as it is measured.

    Raises:
        ValueError: There is no such part, or a number is out of range.
        RuntimeError: A peer failed.
    """
    model = config.options().load_part().model
    peers = available(peers, interpreters)
    scenes, cases = pose_cases(config, count, whole_scenes)
    points, segments = model_points(model), [case for case in cases if case.instance is not None]
    for threads in THREADS:
        yield from pose_rows(OURS, threads, cases, run_ours(config.options(), scenes, cases, threads), model)
        for peer in peers:
            given = cases if peer.whole_scenes else segments
            python = interpreters[peer.family]
            if python is not None and given:
                answers = run_peer(peer, python, points, model.d_max, given, threads)
                yield from pose_rows(peer.name, threads, given, answers, model)


def pose_rows(
    method: str, threads: int, cases: Sequence[PoseCase], answers: Answers, part: PartModel
) -> Iterator[PoseRow]:
    """Yield the row of the segments and that of the whole bins, if there are such cases.

    Args:
        method: Name of the method.
        threads: Number of threads that the method was allowed.
        cases: Cases with their true poses.
        answers: Poses that the method found in the cases.
        part: Model of the part.
    """
    for inputs in (SEGMENTS, WHOLE):
        chosen = [k for k, case in enumerate(cases) if (case.instance is None) == (inputs == WHOLE)]
        if not chosen:
            continue
        verdicts = [
            [judge(cases[k], poses[k], scores[k], part) for k in chosen]
            for poses, scores in zip(answers.poses, answers.scores, strict=True)
        ]
        yield PoseRow(
            name=f"{part.name}, {inputs}, {method}, threads: {threads}",
            unit="ms",
            values=tuple(answers.ms[:, chosen].ravel().tolist()),
            inputs=inputs,
            method=method,
            version=answers.version,
            threads=threads,
            build_s=answers.build_s,
            cpu_ms=tuple(answers.cpu_ms[:, chosen].ravel().tolist()),
            trials=len(chosen),
            right=tuple(sum(right for right, _ in row) for row in verdicts),
            found=sum(found for _, found in verdicts[0]),
            to_find=sum(int(cases[k].to_find.sum()) for k in chosen),
        )


def judge(case: PoseCase, poses: Floats, scores: Floats, part: PartModel) -> tuple[bool, int]:
    """Return whether the best pose is right, and the number of instances that the first ``case.top`` poses find.

    Args:
        case: Case with its true poses.
        poses: (H, 4, 4) ``T_cam_part``, the best first; a pose that is not finite is wrong.
        scores: (H,) scores, higher is better.
        part: Model of the part.
    """
    poses, scores = poses[: case.top], scores[: case.top]
    finite = np.isfinite(poses).all(axis=(1, 2)) & np.isfinite(scores)
    distances = recognition_distances(poses[finite], case.T_cam_parts, part)
    found = int(judge_poses(distances, scores[finite], case.to_find, np.inf).correct.sum())
    right = len(poses) > 0 and bool(finite[0]) and bool(np.isfinite(distances[0]).any())
    return right, found


def pose_table(rows: Sequence[PoseRow]) -> str:
    """Return recognition with its 95 % interval and range over repeats, instances found, and times, as text."""
    ours = {(row.inputs, row.threads): row.median for row in rows if row.method == OURS}
    header = ("", "threads", "recognised", "", "95 %", "repeats", "found", "median ms", "CPU ms", "of ours", "build s")
    cells: list[tuple[str, ...]] = [header]
    for row in rows:
        share = rate(row.typical, row.trials)
        reference = ours.get((row.inputs, row.threads))
        cells.append(
            (
                f"{row.inputs}: {row.method}",
                str(row.threads),
                f"{row.typical}/{row.trials}",
                percent(share.value),
                f"{100 * share.low:.0f} to {100 * share.high:.0f}",
                f"{min(row.right)} to {max(row.right)} in {len(row.right)}" if len(row.right) > 1 else "",
                f"{row.found}/{row.to_find}" if row.inputs == WHOLE else "",
                number(row.median, 0),
                number(float(np.median(row.cpu_ms)), 0),
                f"{row.median / reference:.1f} x" if reference else "–",
                number(row.build_s, 1),
            )
        )
    return columns(cells)
