"""Candidates in full, nearly empty and empty bins by perceivers that work from pixels."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from binpick_env.env import BinPickEnv
from binpick_env.parts import load_part
from perception.metrics.pose_errors import is_recognised, pose_error
from tests.binpick_env.observed_cell import assert_right, cell, in_play, no_weights_of_the_users_own, seen_in  # noqa: F401
from tests.binpick_env.small_cell import above_tray, act, centred, grip

PARTS = ("tee", "part_a", "part_b", "part_c", "bracket")
MODES = ("learned", "gt_masks")


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
def test_an_empty_bin_has_no_candidates(mode: str) -> None:
    env = cell(perception=mode)
    observation, _ = env.reset(seed=31, options={"num_parts": 0})
    assert not observation["candidate_mask"].any()
    assert env.candidates == []
    seen = seen_in(env)
    assert (len(seen.boundary), seen.segments, seen.poses, seen.estimates) == (0, [], [], [])


@pytest.mark.slow
def test_parts_in_the_tray_and_in_the_gripper_are_none() -> None:
    env = cell()
    env.reset(seed=31)
    simulation = env.simulation
    assert {c.part for c in env.candidates} == {0, 1, 2}
    simulation.place(0, above_tray(simulation, z=0.03))
    grip(simulation, 1)
    assert 1 in simulation.gripped()
    env.look()
    assert [c.part for c in env.candidates] == [2]
    assert_right(env, env.candidates)
    x, y, _ = env.workspace.T_world_bin[:3, 3]
    beside = -0.1 * np.sign(simulation.part_poses()[2, 0, 3] - x)  # the last part stays in sight
    simulation.place(1, centred(simulation, (x + beside, y, 0.30)))  # as if held over the bin
    env.look()
    assert [c.part for c in env.candidates] == [2]


@pytest.mark.slow
@pytest.mark.parametrize(("part", "mode"), [*((part, "learned") for part in PARTS), ("part_b", "gt_masks")])
def test_one_two_and_three_parts_are_all_found(part: str, mode: str) -> None:
    env = cell(part, 3, mode)
    for count in (1, 2, 3):
        env.reset(seed=31, options={"num_parts": count})
        assert {c.part for c in env.candidates} == in_play(env)
        assert len(env.candidates) == count
        assert_right(env, env.candidates)
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("part", PARTS)
def test_of_a_full_bin_most_parts_are_found_and_what_it_hides_when_that_is_left(part: str) -> None:
    """The three most hidden parts of a pile, at its bottom and in its corners, become the last ones."""
    env = cell(part, 25)
    env.reset(seed=31)
    assert_most_are_found(env)
    order = [int(i) for i in np.argsort(env.labelled_capture.visible_fractions, kind="stable")]
    for count in (3, 1):
        for i in in_play(env) - set(order[:count]):
            env.simulation.park(i)
        act(env, 0.6)
        env.look()
        assert {c.part for c in env.candidates} == in_play(env) == set(order[:count])
        assert len(env.candidates) == count
        assert_right(env, env.candidates)
    env.close()


def assert_most_are_found(env: BinPickEnv) -> None:
    truth, model = env.simulation.part_poses(), env.part.model
    seen = {int(i) for i in np.flatnonzero(env.labelled_capture.visible_fractions >= 0.5)}
    right = [
        c.part
        for c in env.candidates
        if c.part >= 0 and is_recognised(pose_error(c.T_world_part, truth[c.part], model), model.d_max)
    ]
    assert len(seen & set(right)) >= 0.75 * len(seen) >= 7
    assert len(right) >= 0.85 * len(env.candidates)


@pytest.mark.slow
def test_a_part_of_ones_own_is_found_by_its_true_segments(tmp_path: Path) -> None:
    block = trimesh.util.concatenate(
        [trimesh.creation.box((60, 40, 20)), trimesh.creation.box((20, 40, 20)).apply_translation((20, 0, 19))]
    )
    merged = trimesh.boolean.union(block.split(), engine="manifold")
    merged.export(tmp_path / "step.stl")
    env = BinPickEnv(load_part(str(tmp_path / "step.stl"), unit="mm"), 2, "gt_masks", threads=1)
    env.reset(seed=31)
    assert {c.part for c in env.candidates} == {0, 1}
    assert_right(env, env.candidates)
    env.close()
