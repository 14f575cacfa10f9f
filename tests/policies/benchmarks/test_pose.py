"""Methods are judged alike, with one thread and two; no real peer is run here."""

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from binpick_env.config import CameraConfig
from binpick_env.options import CellOptions
from binpick_env.scenes.synthesis import SceneConfig
from perception.geometry import Floats, invert_transform, make_transform, rotation_about
from perception.instance import Instance
from policies.benchmarks import pose as bench
from policies.benchmarks.measurement import load_benchmark, save_benchmark
from policies.benchmarks.pose import OURS, PoseRow, bench_pose, judge, pose_rows, pose_table
from policies.benchmarks.pose_peer_inputs import PoseCase, pose_cases
from policies.benchmarks.pose_peer_ours import answer, run_ours
from policies.benchmarks.pose_peers import Answers, Peer
from policies.commands import bench as command
from tests.policies.benchmarks.pose_peer_cases import TEE, case, fake_peer

pytestmark = pytest.mark.slow


@pytest.fixture
def fake(tmp_path: Path) -> Peer:
    return fake_peer(tmp_path)


def answers(*repeats: Sequence[Floats], ms: float = 2.0) -> Answers:
    shape = (len(repeats), len(repeats[0]))
    poses = [[np.reshape(found, (-1, 4, 4)) for found in row] for row in repeats]
    scores = [[-np.arange(len(found), dtype=np.float64) for found in row] for row in poses]
    times = {"ms": np.full(shape, ms), "cpu_ms": np.full(shape, ms / 2)}
    return Answers(version="1", build_s=0.5, **times, poses=poses, scores=scores)


def right(T: Floats, truth: PoseCase) -> bool:
    return judge(truth, np.reshape(T, (-1, 4, 4)), np.zeros(np.size(T) // 16), TEE)[0]


# Judgement


def test_a_pose_is_right_within_a_tenth_of_the_diameter_and_five_degrees_modulo_symmetry() -> None:
    truth = case()
    T = truth.T_cam_parts[0]
    about_centre = make_transform(translation=TEE.centre)

    def turned(degrees: float) -> Floats:
        turn = make_transform(rotation_about((1, 1, 0), np.deg2rad(degrees)))
        return T @ about_centre @ turn @ invert_transform(about_centre)

    assert right(T, truth)
    assert right(turned(4.9), truth)
    assert not right(turned(5.1), truth)
    assert right(make_transform(translation=(0.099 * TEE.d_max, 0, 0)) @ T, truth)
    assert not right(make_transform(translation=(0.101 * TEE.d_max, 0, 0)) @ T, truth)
    half_turn = make_transform(TEE.symmetry.rotations[1])
    assert right(T @ about_centre @ half_turn @ invert_transform(about_centre), truth)


def test_no_pose_and_a_pose_that_is_no_number_are_wrong() -> None:
    truth = case()
    assert judge(truth, np.zeros((0, 4, 4)), np.zeros(0), TEE) == (False, 0)
    assert judge(truth, np.full((1, 4, 4), np.nan), np.zeros(1), TEE) == (False, 0)
    two = np.stack([np.full((4, 4), np.nan), truth.T_cam_parts[0]])
    assert judge(case(top=2), two, np.zeros(2), TEE) == (False, 1)  # the best is no number


def test_in_a_whole_bin_any_part_is_right_and_each_counts_once() -> None:
    parts = np.stack([make_transform(translation=(x, 0, 1)) for x in (0.0, 0.2, 0.4)])
    truth = case(parts, top=3, whole=True)
    nowhere = make_transform(translation=(0, 0.3, 1))
    found = np.stack([parts[1], parts[1], parts[2], parts[0]])
    assert judge(truth, found, -np.arange(4.0), TEE) == (True, 2)  # one twice, and the fourth was not asked for
    assert judge(truth, np.stack([nowhere, parts[0]]), np.array([1.0, 0.0]), TEE) == (False, 1)


def test_rows_count_the_right_ones_by_repeat_and_kind() -> None:
    T = case().T_cam_parts[0]
    wrong = make_transform(translation=(1, 0, 1))
    cases = [case(), case(), case(whole=True)]
    rows = list(pose_rows("Fake", 2, cases, answers([T, T, wrong], [T, wrong, T], [wrong, wrong, wrong]), TEE))
    assert [(row.inputs, row.trials, row.right, row.typical) for row in rows] == [
        ("true segments", 2, (2, 1, 0), 1),
        ("whole bins", 1, (0, 1, 0), 0),
    ]
    assert [len(row.values) for row in rows] == [6, 3]
    assert [(row.found, row.to_find) for row in rows] == [(2, 2), (0, 1)]
    assert len({row.name for row in rows}) == 2


def test_the_table_compares_with_ours_at_as_many_threads() -> None:
    T = case().T_cam_parts[0]
    rows: list[PoseRow] = []
    for method, threads, ms in ((OURS, 1, 4.0), ("Fake", 1, 20.0), (OURS, 2, 2.0), ("Fake", 2, 20.0)):
        rows += pose_rows(method, threads, [case()], answers([T], ms=ms), TEE)
    lines = pose_table(rows).splitlines()
    assert [line.split(" x")[0].split()[-1] for line in lines[1:]] == ["1.0", "5.0", "1.0", "10.0"]
    assert "1/1  100.0 %  21 to 100" in lines[1]  # Wilson's interval of one success
    assert " x" not in pose_table(rows[1:2])  # without ours there is no ratio


def test_rows_are_kept_with_their_counts_and_read_as_times(tmp_path: Path) -> None:
    rows = list(pose_rows(OURS, 1, [case()], answers([case().T_cam_parts[0]]), TEE))
    save_benchmark(tmp_path / "pose.json", "pose", rows)
    (kept,) = json.loads((tmp_path / "pose.json").read_text())["rows"]
    assert (kept["right"], kept["trials"], kept["threads"], kept["version"]) == ([1], 1, 1, "1")
    assert load_benchmark(tmp_path / "pose.json")[0].values == (2.0,)


# The whole


class FakeEstimator:
    """Finds each segment's pose at the index of its first point, and two in a whole scene."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def estimate_groups(self, boundary: object, instances: Sequence[Instance], frame: object) -> list[Any]:
        self.asked.append("group")
        first = int(instances[0].point_idx[0])
        return [SimpleNamespace(T_cam_part=make_transform(translation=(first, 0, 0)), score=0.5) if first else None]

    def estimate_scene(self, boundary: object, frame: object) -> list[Any]:
        self.asked.append("scene")
        return [SimpleNamespace(T_cam_part=np.eye(4), score=s) for s in (0.9, 0.8)]


def test_ours_is_warmed_up_and_asked_once_for_each_case() -> None:
    estimator: Any = FakeEstimator()
    scenes: Any = [SimpleNamespace(boundary=None, frame=None)]
    third = replace(case(), instance=Instance(point_idx=np.array([3, 4]), score=1.0))
    got = answer(estimator, scenes, [case(), third, case(whole=True)], build_s=2.0)
    assert estimator.asked == ["scene", "group", "group", "group", "scene"]
    assert [len(poses) for poses in got.poses[0]] == [0, 1, 1]  # none found; one; of two the one that was asked for
    assert got.poses[0][1][0, 0, 3] == 3
    assert [scores.tolist() for scores in got.scores[0]] == [[], [0.5], [0.9]]
    assert got.ms.shape == (1, 3)
    with pytest.raises(ValueError, match="our method needs at least one case, got none"):
        run_ours(CellOptions(), [], [], threads=1)


def test_every_method_is_measured_with_one_thread_and_two(fake: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = [case(), case(whole=True)]

    def truth(part: str, scenes: object, cases: Sequence[PoseCase], threads: int) -> Answers:
        return answers([found.T_cam_parts[:1] for found in cases])

    monkeypatch.setattr(bench, "pose_cases", lambda *_: ([], cases))
    monkeypatch.setattr(bench, "run_ours", truth)
    peers = [fake, replace(fake, name="Thorough", whole_scenes=True), replace(fake, name="Absent", family="absent")]
    rows = list(bench_pose(SceneConfig(seed=31), 1, 1, {"fake": Path(sys.executable)}, peers))
    expected = [(OURS, "true segments"), (OURS, "whole bins"), ("Fake", "true segments")]
    expected += [("Thorough", "true segments"), ("Thorough", "whole bins")]
    assert [(row.method, row.inputs) for row in rows] == 2 * expected
    assert [row.threads for row in rows] == [1] * 5 + [2] * 5
    assert [sum(row.right) for row in rows[:5]] == [1, 1, 0, 0, 0]  # the fake's guesses are metres away
    assert len({row.name for row in rows}) == len(rows)


def test_the_command_prints_the_table_and_ends_a_mistake_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    rows = list(pose_rows(OURS, 1, [case()], answers([case().T_cam_parts[0]]), TEE))
    asked: list[object] = []
    file = tmp_path / "pose.json"
    with monkeypatch.context() as patch:
        patch.setattr(bench, "bench_pose", lambda *args: asked.append(args) or iter(rows))
        assert command.run(command.Pose(part="tee", seed=3, opencv_python=Path("p"), save=file)) == 0
    assert pose_table(rows) in capsys.readouterr().out
    assert asked == [(SceneConfig(part="tee", seed=3), 20, 2, {"opencv": Path("p"), "open3d": None})]
    assert load_benchmark(file)[0].name == rows[0].name
    assert command.run(command.Pose(part="teapot")) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("error: part must be one of part_a")


def test_ours_runs_in_a_process_of_its_own() -> None:
    before = dict(os.environ)
    config = SceneConfig(part="tee", seed=31, num_parts=(3, 3), camera=CameraConfig(width=640, height=480))
    scenes, cases = pose_cases(config, 1, 0)
    got = run_ours(config.options(), scenes, cases, threads=1)
    assert dict(os.environ) == before
    assert [len(poses) for poses in got.poses[0]] == [1, 1, 1]
    assert (got.ms > 0).all()
    assert sum(judge(c, p, s, TEE)[0] for c, p, s in zip(cases, got.poses[0], got.scores[0], strict=True)) >= 2
