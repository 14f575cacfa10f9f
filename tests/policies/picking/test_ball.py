"""A ball from a file, whose orientation is free, is seen, grasped and delivered."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh

from binpick_env.env import BinPickEnv
from perception.metrics.pose_errors import pose_error
from policies.grasping.grasps import GraspSettings, sample_grasps
from policies.grasping.outcomes import GraspOutcome
from policies.picking import scripted
from policies.picking.scripted import ScriptedPicker
from tests.policies.hand_cell import SMALL_IMAGE

FEW = GraspSettings(samples=250, max_grasps=600, max_checked=5000)  # a second instead of ten


@pytest.mark.slow
def test_a_ball_is_seen_grasped_and_delivered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    trimesh.creation.icosphere(subdivisions=3, radius=0.02).export(tmp_path / "ball.stl")
    monkeypatch.setattr(scripted, "sample_grasps", partial(sample_grasps, settings=FEW))
    env = BinPickEnv(str(tmp_path / "ball.stl"), num_parts=3, perception="gt_masks", camera=SMALL_IMAGE)
    ball = env.part.model
    assert ball.symmetry.sphere
    grasps = sample_grasps(ball, FEW)
    assert len(grasps) > 100
    np.testing.assert_allclose(grasps.width, 0.04, rtol=0.02)
    env.reset(seed=3)
    assert len(env.observed.candidates) == 3
    for candidate in env.observed.candidates:
        errors = [pose_error(candidate.T_world_part, T, ball) for T in env.labelled_capture.T_world_parts]
        assert min(error.translation for error in errors) < 0.001
        assert all(error.rotation == 0 for error in errors)
    assert ScriptedPicker(env).pick().outcome is GraspOutcome.DELIVERED
    env.close()
