"""Pose estimation against other people's on the same inputs: who is right how often, and how long it takes.

True segments, for which the peers are given every pixel of the true part with its depth and a normal that is not
counted in their time, more than any segmentation would give them; and whole bins, where the pose of any part is right.
All are judged by the paper's criterion: 10 % of d_max at the part's centre and 5 degrees modulo symmetry.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from binpick_env.jobs.text_tables import columns, number, percent
from binpick_env.parts import load_part
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
    """The times of one method on one kind of input [ms], and how often it was right.

    Attributes:
        inputs: `SEGMENTS` or `WHOLE`.
        method: Name.
        version: Of it.
        threads: That it might use.
        build_s: Building its models [s].
        cpu_ms: Time of all processors for each of the values [ms].
        trials: Cases.
        right: Of them, how many times the best pose was right, for each repeat.
        found: Instances found by all poses together, in the first repeat.
        to_find: Of how many.
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
        """Times the best pose was right in the median repeat."""
        return sorted(self.right)[len(self.right) // 2]


def bench_pose(
    part: str,
    seed: int,
    count: int,
    whole_scenes: int,
    interpreters: Mapping[str, Path | None],
    peers: Sequence[Peer] = PEERS,
) -> Iterator[PoseRow]:
    """Measure ours and every peer that has an interpreter, with one thread and two; rows come method by method.

    Args:
        part: Catalogue name or mesh file.
        seed: Of the scenes.
        count: Number of scenes, each of three segments.
        whole_scenes: How many of them are searched as a whole, too.
        interpreters: By peer's family; those without one are left out, with a line in the log.
        peers: That are compared.

    Raises:
        ValueError: There is no such part, or a number is out of range.
        RuntimeError: A peer failed.
    """
    model = load_part(part).model
    peers = available(peers, interpreters)
    sights, cases = pose_cases(part, seed, count, whole_scenes)
    points, segments = model_points(model), [case for case in cases if case.instance is not None]
    for threads in THREADS:
        yield from pose_rows(OURS, threads, cases, run_ours(part, sights, cases, threads), model)
        for peer in peers:
            asked = cases if peer.whole_scenes else segments
            python = interpreters[peer.family]
            if python is not None and asked:
                answers = run_peer(peer, python, points, model.d_max, asked, threads)
                yield from pose_rows(peer.name, threads, asked, answers, model)


def pose_rows(
    method: str, threads: int, cases: Sequence[PoseCase], answers: Answers, part: PartModel
) -> Iterator[PoseRow]:
    """Judge a method's answers; a row for segments and one for whole bins, where there are any."""
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
    """Return whether the best pose is right, and how many instances the poses asked for find together.

    Args:
        case: With its truth.
        poses: (H, 4, 4), the best first; those that are not finite are wrong.
        scores: (H,).
        part: That was looked for.
    """
    poses, scores = poses[: case.top], scores[: case.top]
    finite = np.isfinite(poses).all(axis=(1, 2)) & np.isfinite(scores)
    distances = recognition_distances(poses[finite], case.T_cam_parts, part)
    found = int(judge_poses(distances, scores[finite], case.to_find, np.inf).correct.sum())
    right = len(poses) > 0 and bool(finite[0]) and bool(np.isfinite(distances[0]).any())
    return right, found


def pose_table(rows: Sequence[PoseRow]) -> str:
    """Return recognition with its 95 % interval and the lowest and highest repeat, instances found, and times."""
    ours = {(row.inputs, row.threads): row.median for row in rows if row.method == OURS}
    head = ("", "threads", "recognised", "", "95 %", "repeats", "found", "median ms", "CPU ms", "of ours", "build s")
    cells: list[tuple[str, ...]] = [head]
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
