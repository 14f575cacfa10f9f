"""Peers run in processes of their own and say what they lack; no real one is run here."""

import logging
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from perception.geometry import make_transform
from policies.benchmarks.pose_peer_inputs import model_points
from policies.benchmarks.pose_peers import PEERS, Answers, Peer, available, fault, run_peer
from policies.commands.bench import Pose
from tests.policies.benchmarks.pose_peer_cases import TEE, case, fake_peer

pytestmark = pytest.mark.slow


@pytest.fixture
def fake(tmp_path: Path) -> Peer:
    return fake_peer(tmp_path)


def test_a_peer_gets_the_inputs_and_its_poses_and_times_come_back(fake: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", "/somewhere")  # where a peer would find our packages instead of its own
    cases = [case(top=1), case(top=3, whole=True, points=np.full((7, 6), 4.0))]
    got = run_peer(replace(fake, repeats=2), Path(sys.executable), model_points(TEE), TEE.d_max, cases, threads=1)
    assert got.version == "fake 5 1"  # one to warm up, then two cases twice; one thread; no PYTHONPATH
    assert [[len(poses) for poses in row] for row in got.poses] == [[1, 3], [1, 3]]
    np.testing.assert_array_equal(got.poses[0][0], make_transform(translation=(11, 1, 1))[None])
    np.testing.assert_array_equal(got.poses[1][1][:, 0, 3], [14, 15, 16])
    np.testing.assert_array_equal(got.scores[1][1], [0, -1, -2])
    assert got.ms.shape == got.cpu_ms.shape == (2, 2)
    assert (got.ms > 0).all()
    assert got.build_s > 0


def test_a_peer_may_find_nothing(fake: Peer) -> None:
    none = replace(fake, setting="0")
    got = run_peer(none, Path(sys.executable), model_points(TEE), TEE.d_max, [case(), case()], threads=1)
    assert [poses.shape for poses in got.poses[0]] == [(0, 4, 4), (0, 4, 4)]


@pytest.mark.skipif(len(getattr(os, "sched_getaffinity", lambda _: ())(0)) < 2, reason="needs two cores")
def test_a_peer_gets_the_threads(fake: Peer) -> None:
    got = run_peer(fake, Path(sys.executable), model_points(TEE), TEE.d_max, [case()], threads=2)
    assert got.version == "fake 2 2"
    assert got.poses[0][0][0, 0, 3] == 21


def test_a_failed_peer_is_an_error_with_its_reason(fake: Peer) -> None:
    failing = replace(fake, setting="fail")
    with pytest.raises(RuntimeError, match="Fake failed with exit code 1: ArithmeticError: no pose today"):
        run_peer(failing, Path(sys.executable), model_points(TEE), TEE.d_max, [case()], threads=1)
    with pytest.raises(ValueError, match="Fake needs at least one case, got none"):
        run_peer(fake, Path(sys.executable), model_points(TEE), TEE.d_max, [], threads=1)


def test_a_peer_that_cannot_run_is_left_out_with_its_remedy(fake: Peer) -> None:
    python = Path(sys.executable)
    assert fault(fake, python) is None
    remedy = "python3 -m venv runs/peers/fake && runs/peers/fake/bin/pip install numpy"
    absent = fault(fake, None)
    assert absent == f"fake is left out; to have it: {remedy}, then --fake-python runs/peers/fake/bin/python"
    gone = fault(fake, Path("/nowhere/python"))
    assert gone is not None
    assert gone.startswith("fake is left out: --fake-python /nowhere/python cannot be run (No such file")
    bare = fault(replace(fake, probe="import no_such_peer"), python)
    assert bare is not None
    assert "ModuleNotFoundError: No module named 'no_such_peer'" in bare
    assert all(text.endswith(remedy) for text in (gone, bare))


def test_a_family_that_is_left_out_is_warned_of_once(fake: Peer, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        assert available([*PEERS, fake], {"fake": Path(sys.executable)}) == [fake]
    said = [record.getMessage().split()[0] for record in caplog.records]
    assert sorted(said) == ["open3d", "opencv"]


def test_every_peer_has_its_file_and_an_option_of_the_command() -> None:
    assert all(peer.method.is_file() for peer in PEERS)
    assert all(f"{peer.family}_python" in Pose.__dataclass_fields__ for peer in PEERS)


def test_impossible_peers_and_answers_are_refused(fake: Peer) -> None:
    with pytest.raises(ValueError, match="repeats must be at least 1, got 0"):
        replace(fake, repeats=0)
    good = Answers(
        version="1",
        build_s=0.5,
        ms=np.ones((1, 1)),
        cpu_ms=np.ones((1, 1)),
        poses=[[np.eye(4)[None]]],
        scores=[[np.zeros(1)]],
    )
    with pytest.raises(ValueError, match=r"poses must be for \(1, 1\) repeats and cases"):
        replace(good, poses=[[], []])
    with pytest.raises(ValueError, match=r"scores must be for \(1, 1\) repeats and cases"):
        replace(good, scores=[[]])
    with pytest.raises(ValueError, match=r"cpu_ms must be \(1, 1\), got \(2, 1\)"):
        replace(good, cpu_ms=np.ones((2, 1)))
