"""Candidates from pixels: what becomes of a pose, how a cell sees by them."""

import pickle
from dataclasses import replace

import cv2
import gymnasium as gym
import numpy as np
import pytest
import torch

import binpick_env  # noqa: F401  registers the id
from binpick_env.candidates import PoseCandidate
from binpick_env.env import BinPickEnv
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.pixel_perceiver import (
    LIKELY,
    MIN_POINTS,
    PixelPerceiver,
    main_owner,
    point_owners,
)
from perception.instance import Instance, true_instances
from perception.pipeline import Perception
from perception.pose.candidates import expected_points
from perception.pose.estimator import PoseEstimator
from perception.pose.pose_estimate import PoseEstimate
from tests.binpick_env.observed_cell import assert_right, cell, in_play, no_weights_of_the_users_own, seen_in  # noqa: F401
from tests.binpick_env.small_cell import REST, act, assert_same, random_actions

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def learned() -> BinPickEnv:
    return cell()


@pytest.fixture(scope="module")
def known() -> BinPickEnv:
    """A cell whose segments are the true ones."""
    env = cell(perception="gt_masks")
    env.reset(seed=31)
    return env


# --- cells of their own, before those that tests share are made


def test_threads_arrive_at_the_perceiver() -> None:
    for given, threads in ((None, 1), (2, 2)):
        perceiver = cell("bracket", perception="gt_masks", threads=given)._perceiver
        assert isinstance(perceiver, PixelPerceiver)
        assert perceiver._threads == threads


def test_gym_makes_a_cell_that_sees_by_pixels() -> None:
    env = gym.make("BinPick-v0", num_parts=3, threads=1)
    inner = env.unwrapped
    assert isinstance(inner, BinPickEnv)
    observation, _ = env.reset(seed=31)
    seen = seen_in(inner)
    assert len(seen.boundary) > 1000
    assert set(seen.ms) == {"boundary", "segmentation", "poses", "explanation"}
    assert observation["candidate_mask"].sum() == len(seen.poses) == 3
    assert_right(inner, inner.candidates)
    truth = inner.simulation.part_poses()
    for candidate in inner.candidates:  # estimated, not perceived up
        assert np.abs(candidate.T_world_part - truth[candidate.part]).max() > 1e-7
        assert 0.5 <= candidate.score < 1.0
    env.close()


# --- from a pose to a candidate


def estimator_of(env: BinPickEnv) -> PoseEstimator:
    perceiver = env._perceiver
    assert isinstance(perceiver, PixelPerceiver)
    return perceiver._estimator


def shown(env: BinPickEnv, seen: Perception, threads: int | None = None, *, likely: bool = False) -> ObservedCandidates:
    """Return what a perceiver makes of a perception."""
    return PixelPerceiver(lambda view: seen, estimator_of(env), threads).perceive(
        env.labelled_capture, np.random.default_rng(0), likely=likely
    )


def test_a_pose_is_completed_to_a_candidate(known: BinPickEnv) -> None:
    seen, part = seen_in(known), known.part.model
    assert len(seen.poses) == len(known.candidates) == 3
    T_world_cam, K = known.frame.T_world_cam, known.frame.K
    for pose, candidate in zip(seen.poses, known.candidates, strict=True):
        np.testing.assert_allclose(candidate.T_world_part, T_world_cam @ pose.T_cam_part, atol=1e-12)
        assert (candidate.score, candidate.visible_fraction) == (pose.score, pose.visible_fraction)
        depth = T_world_cam[2, 3] - candidate.centre_world[2]  # the camera looks straight down
        points = len(seen.segments[pose.instance_idx].point_idx)
        assert candidate.fill == pytest.approx(points / expected_points(part, K, depth), rel=0.01)
        assert 0.3 < candidate.fill < 1.5
        vertices = np.asarray(part.mesh.vertices) @ candidate.T_world_part[:3, :3].T + candidate.T_world_part[:3, 3]
        assert candidate.top == pytest.approx(vertices[:, 2].max() - known.workspace.T_world_bin[2, 3])
    scores = [candidate.score for candidate in known.candidates]
    assert scores == sorted(scores, reverse=True)
    assert_right(known, known.candidates)
    assert {candidate.part for candidate in known.candidates} == in_play(known)


def test_the_order_is_that_of_the_poses(known: BinPickEnv) -> None:
    seen = seen_in(known)
    turned = shown(known, replace(seen, poses=seen.poses[::-1]))
    assert [c.part for c in turned.candidates] == [c.part for c in known.candidates][::-1]
    assert turned.perception is not None
    assert [pose.instance_idx for pose in turned.perception.poses] == [p.instance_idx for p in seen.poses[::-1]]


def test_a_candidate_is_of_the_part_that_owns_most_of_its_group(known: BinPickEnv) -> None:
    seen, capture = seen_in(known), known.labelled_capture.capture
    owners = point_owners(known.labelled_capture, seen.boundary)
    u, v = seen.boundary.pixels[::100].T
    np.testing.assert_array_equal(owners[::100], [capture.instance_ids[b, a] for a, b in zip(u, v, strict=True)])
    a, b, c = (np.flatnonzero(owners == part)[:100] for part in sorted(in_play(known)))
    mixed = np.sort(np.concatenate([a[:30], b[:40], c[:35]]))
    (candidate,) = shown(known, with_group(seen, mixed)).candidates
    assert candidate.part == sorted(in_play(known))[1]
    assert candidate.fill == pytest.approx(105 / len_expected(known, candidate))


def with_group(seen: Perception, idx: np.ndarray) -> Perception:
    """Return a perception of one group, whose pose is the first one."""
    pose = replace(seen.poses[0], instance_idx=0)
    group = Instance(point_idx=idx, score=1.0)
    return replace(seen, segments=[group], groups=[group], poses=[pose], estimates=[pose])


def len_expected(env: BinPickEnv, candidate: PoseCandidate) -> int:
    depth = env.frame.T_world_cam[2, 3] - candidate.centre_world[2]
    return expected_points(env.part.model, env.frame.K, float(depth))


@pytest.mark.parametrize(
    ("owners", "part"), [([4], 4), ([-1, -1, 2], -1), ([2, 0, 2, -1], 2), ([0, 0, 0, 1, 1, -1, -1], 0)]
)
def test_the_main_owner_by_hand(owners: list[int], part: int) -> None:
    assert main_owner(np.array(owners, np.int64)) == part


def test_a_group_on_the_container_is_no_parts(known: BinPickEnv) -> None:
    ids = np.where(known.labelled_capture.capture.measured_ids >= 0, -1, 0)
    view = replace(known.labelled_capture, capture=replace(known.labelled_capture.capture, measured_ids=ids))
    perceiver = PixelPerceiver(lambda _: seen_in(known), estimator_of(known))
    observed = perceiver.perceive(view, np.random.default_rng(0))
    assert [c.part for c in observed.candidates] == [-1, -1, -1]


# --- segments


def test_true_segments_are_the_parts_points_that_are_enough(known: BinPickEnv) -> None:
    boundary = seen_in(known).boundary
    owners = point_owners(known.labelled_capture, boundary)
    first, second, third = sorted(in_play(known))
    cut = np.concatenate(
        [
            np.flatnonzero(owners == first)[:MIN_POINTS],
            np.flatnonzero(owners == second)[: MIN_POINTS - 1],
            np.flatnonzero(owners == third),
        ]
    )
    segments = true_instances(point_owners(known.labelled_capture, boundary.only(np.sort(cut))), MIN_POINTS)
    owners = owners[np.sort(cut)]
    assert [np.unique(owners[segment.point_idx]).tolist() for segment in segments] == [[first], [third]]
    assert [len(segment.point_idx) for segment in segments] == [MIN_POINTS, np.count_nonzero(owners == third)]
    assert {segment.score for segment in segments} == {1.0}
    nothing = boundary.only(np.zeros(len(boundary), np.bool_))
    assert true_instances(point_owners(known.labelled_capture, nothing), MIN_POINTS) == []


def test_gt_masks_segments_are_pure_and_a_networks_nearly(known: BinPickEnv, learned: BinPickEnv) -> None:
    learned.reset(seed=31)
    np.testing.assert_array_equal(learned.frame.depth, known.frame.depth)  # the same bin
    for env, least in ((known, 1.0), (learned, 0.8)):
        seen = seen_in(env)
        owners = point_owners(env.labelled_capture, seen.boundary)
        purities = [np.bincount(owners[s.point_idx] + 1).max() / len(s.point_idx) for s in seen.segments]
        assert min(purities) >= least
    assert {segment.score for segment in seen_in(known).segments} == {1.0}
    assert {segment.score for segment in seen_in(learned).segments} != {1.0}


# --- poses that are not verified


def doubtful(seen: Perception, *scores: float) -> Perception:
    """Return a perception whose poses have other scores, none of which is verified."""
    estimates: list[PoseEstimate | None] = [
        replace(pose, score=score, surface_score=score) for pose, score in zip(seen.poses, scores, strict=True)
    ]
    return replace(seen, poses=[], estimates=[*estimates, None])


def test_where_no_pose_is_verified_the_likely_ones_stand_in(known: BinPickEnv) -> None:
    seen = seen_in(known)
    observed = shown(known, doubtful(seen, LIKELY - 0.01, 0.6, LIKELY))
    assert [c.score for c in observed.candidates] == [0.6, LIKELY]
    assert observed.perception is not None
    assert [pose.score for pose in observed.perception.poses] == [0.6, LIKELY]
    assert [c.part for c in observed.candidates] == [known.candidates[k].part for k in (1, 2)]
    assert shown(known, doubtful(seen, 0.1, 0.2, 0.49)).candidates == []


def test_beside_a_verified_pose_none_stands_in(known: BinPickEnv) -> None:
    seen = seen_in(known)
    told = replace(doubtful(seen, 0.8, 0.8, 0.8), poses=seen.poses[:1])
    assert [c.part for c in shown(known, told).candidates] == [known.candidates[0].part]


def test_likely_poses_stand_beside_a_verified_one_where_they_are_asked_for(known: BinPickEnv) -> None:
    seen = seen_in(known)
    pairs = (0.99, 0.99), (0.3, LIKELY), (0.7, 0.7)  # the second has a rival with nearly the same surface
    estimates = [
        replace(pose, score=score, surface_score=surface)
        for pose, (score, surface) in zip(seen.poses, pairs, strict=True)
    ]
    told = replace(seen, poses=estimates[:1], estimates=estimates)
    assert [c.score for c in shown(known, told).candidates] == [0.99]
    observed = shown(known, told, likely=True)
    assert [c.score for c in observed.candidates] == [0.99, 0.7, 0.3]
    assert observed.perception is not None
    assert [pose.score for pose in observed.perception.poses] == [0.99, 0.7, 0.3]
    unlikely = [*estimates[:1], replace(estimates[1], surface_score=LIKELY - 0.01)]
    assert [c.score for c in shown(known, replace(told, estimates=unlikely), likely=True).candidates] == [0.99]


def test_the_cell_passes_on_that_likely_poses_are_asked_for(known: BinPickEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def perceive(*_: object, likely: bool = False) -> ObservedCandidates:
        asked.append(likely)
        return ObservedCandidates()

    before = known.snapshot()
    monkeypatch.setattr(known._perceiver, "perceive", perceive)
    known.look()
    known.look(likely=True)
    known.restore(before)
    assert asked == [False, True]


# --- threads


def test_one_thread_setting_for_all(learned: BinPickEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    before = torch.get_num_threads(), cv2.getNumThreads()
    threads: list[tuple[int, int]] = []
    perceiver = learned._perceiver
    assert isinstance(perceiver, PixelPerceiver)
    recognise = perceiver._recognise

    def watched(labelled: LabelledCapture) -> Perception:
        threads.append((torch.get_num_threads(), cv2.getNumThreads()))
        return recognise(labelled)

    monkeypatch.setattr(perceiver, "_recognise", watched)
    try:
        torch.set_num_threads(2)
        cv2.setNumThreads(2)
        learned.reset(seed=31)
        assert (torch.get_num_threads(), cv2.getNumThreads()) == (2, 2)
        monkeypatch.setattr(perceiver, "_threads", None)
        learned.look()
    finally:
        torch.set_num_threads(before[0])
        cv2.setNumThreads(before[1])
    assert threads == [(1, 1), (2, 2)]


# --- the environment


def test_a_frame_is_perceived_once(learned: BinPickEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    learned.reset(seed=31)
    perceived: list[LabelledCapture] = []
    perceive = learned._perceiver.perceive

    def counted(view: LabelledCapture, rng: np.random.Generator, **how: bool) -> ObservedCandidates:
        perceived.append(view)
        return perceive(view, rng, **how)

    monkeypatch.setattr(learned._perceiver, "perceive", counted)
    act(learned, 0.4)
    assert perceived == []
    observed = learned.observed
    learned.look()
    assert perceived == [learned.labelled_capture]
    assert learned.observed is not observed
    assert learned.candidates == learned.observed.candidates
    assert sum(seen_in(learned).ms.values()) <= 1000 * learned.perception_time
    away = REST.copy()
    away[0] -= 1.0
    act(learned, 0.8, away)
    assert len(perceived) == 1
    act(learned, 1.2)
    assert len(perceived) == 2


def test_copies_that_learned_to_see_stay_equal(learned: BinPickEnv) -> None:
    """Bit for bit, over frames taken underway, in a pickled copy and in one with another episode behind it."""
    copy = pickle.loads(pickle.dumps(learned))
    copy.reset(seed=77)
    away = REST.copy()
    away[0] -= 1.0
    actions = [*random_actions(learned, 10), *[away] * 20, *[REST] * 25]
    starts = [env.reset(seed=31) for env in (learned, copy)]
    assert_same(starts[0][0], starts[1][0])
    frames = set()
    for action in actions:
        steps = [env.step(action) for env in (learned, copy)]
        assert_same(steps[0][0], steps[1][0])
        assert steps[0][1:] == steps[1][1:]
        frames.add(steps[0][4]["frame_id"])
    assert len(frames) > 1
    assert learned.candidates
    copy.close()
