"""Poses of an L-shaped block found again: occluded, in clutter, in pairs, turned over, and moved."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from perception.frame import Frame
from perception.geometry import Floats, make_transform, rotation_about
from perception.instance import Instance
from perception.metrics.pose_errors import pose_error
from perception.part import PartModel
from perception.pose import estimator as module
from perception.pose import hypothesis_scoring
from perception.pose.estimator import PoseEstimator
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.verification.confidence import ConfidenceConfig, confidence
from perception.runtime.threads import use_threads
from tests.perception.pose import observed_part as at
from tests.perception.pose.estimator_scene import CONFIG, Scene, cloud, quick_estimator, scene_of
from tests.perception.pose.observed_part import SIGMA

ELL = at.ell()
ESTIMATOR = quick_estimator(ELL)
OVER = rotation_about((1.0, 0.0, 0.0), np.pi)
FROM_ABOVE = at.pose_of(ELL, OVER)
LEANING = at.pose_of(ELL, rotation_about((1.0, 1.0, 0.0), 0.7) @ OVER)
SEEN = scene_of(ELL, LEANING)
EMPTY = cloud(np.zeros((0, 3)), np.zeros((0, 3)))
PLATE = trimesh.creation.box((0.2, 0.2, 0.002), make_transform(None, (0.1, 0.0, 0.42)))  # before half of the image


def turned(T: Floats, angle: float, centre: tuple[float, float, float]) -> Floats:
    """Return a pose turned about the optical axis, with the part's centre at a place."""
    rotation = rotation_about((0.0, 0.0, 1.0), angle) @ T[:3, :3]
    return make_transform(rotation, np.array(centre) - rotation @ ELL.centre)


PAIR = turned(FROM_ABOVE, 0.3, (-0.022, 0.0, 0.5)), turned(LEANING, 2.3, (0.022, 0.01, 0.48))  # the second on the first
BOTH = scene_of(ELL, *PAIR)


def assert_at(found: PoseEstimate | None, T: Floats, shift: float = 0.001, degrees: float = 1.0) -> None:
    assert found is not None
    error = pose_error(found.T_cam_part, T, ELL)
    assert error.translation < shift
    assert np.degrees(error.rotation) < degrees


def groups_of(scene: Scene, estimator: PoseEstimator = ESTIMATOR) -> list[PoseEstimate | None]:
    return estimator.estimate_groups(scene.boundary, scene.groups(), scene.frame)


def verified_in(scene: Scene, estimator: PoseEstimator = ESTIMATOR) -> list[PoseEstimate]:
    return estimator.estimate(scene.boundary, scene.groups(), scene.frame)


# Recovery


@pytest.mark.parametrize("seed", [None, *range(6)])
def test_a_pose_is_found_again(seed: int | None) -> None:
    T = FROM_ABOVE if seed is None else at.random_pose(ELL, np.random.default_rng(seed))
    (found,) = verified_in(scene_of(ELL, T))
    assert_at(found, T, 0.0005, 0.5)
    assert found.score > 0.95
    assert found.verdict.explained > 0.9


@pytest.mark.parametrize("seed", range(4))
def test_a_pose_is_found_of_which_half_is_occluded(seed: int) -> None:
    T = at.random_pose(ELL, np.random.default_rng(seed))
    whole, half = scene_of(ELL, T), scene_of(ELL, T, hiders=[PLATE])
    assert len(half.boundary) < 0.65 * len(whole.boundary)
    (found,) = verified_in(half)
    assert_at(found, T, 0.001, 1.25)
    assert found.visible_fraction == found.verdict.support * found.verdict.measured
    assert 0.35 < found.visible_fraction < 0.7
    assert verified_in(whole)[0].visible_fraction > 0.95


@pytest.mark.parametrize("seed", range(4))
def test_a_pose_is_found_among_points_of_nothing(seed: int) -> None:
    T = at.random_pose(ELL, np.random.default_rng(seed))
    scene = scene_of(ELL, T, clutter=200)
    everything = [Instance(point_idx=np.arange(len(scene.boundary)), score=1.0)]
    (found,) = ESTIMATOR.estimate_groups(scene.boundary, everything, scene.frame)
    assert_at(found, T)
    (clean,) = groups_of(scene)
    assert found is not None
    assert clean is not None
    assert found.verdict.logit < clean.verdict.logit - 1  # what it leaves unexplained speaks against it


@pytest.mark.parametrize("seed", range(3))
def test_a_pose_is_found_with_twice_the_noise(seed: int) -> None:
    T = at.random_pose(ELL, np.random.default_rng(seed))
    (found,) = groups_of(scene_of(ELL, T, noise=2 * SIGMA))
    assert_at(found, T)


def test_each_group_has_its_own_pose() -> None:
    found = groups_of(BOTH)
    assert len(found) == 2
    for k, T in enumerate(PAIR):
        assert_at(found[k], T)
        assert found[k].instance_idx == k  # type: ignore[union-attr]
    best = verified_in(BOTH)
    assert [one.instance_idx for one in best] == [1, 0]  # the one on top before the one that it half hides
    assert best[0].score > best[1].score > 0.9


def test_a_scene_is_searched_without_groups() -> None:
    for seed in range(3):
        T = at.random_pose(ELL, np.random.default_rng(seed))
        scene = scene_of(ELL, T, clutter=150)
        found = ESTIMATOR.estimate_scene(scene.boundary, scene.frame)
        assert_at(found[0], T)
        assert found[0].instance_idx == -1
        assert found[0].score > 0.95
    both = ESTIMATOR.estimate_scene(BOTH.boundary, BOTH.frame)
    assert_at(both[0], PAIR[1])
    assert_at(both[1], PAIR[0])
    scores = [one.score for one in both]
    assert scores == sorted(scores, reverse=True)


def test_depth_tells_a_flat_block_from_its_near_symmetric_pose() -> None:
    """The outline of the long arm's face is that of the block turned over about this arm, too."""
    pivot = np.array([0.0, 0.01, at.HEIGHT / 2])
    mirrored = FROM_ABOVE @ make_transform(OVER, pivot - OVER @ pivot)
    points, tangents = at.wires(ELL, 0.0005)
    beyond = (points[:, 2] == at.HEIGHT) & (points[:, 1] < 0.0201) & ((points[:, 0] > 0.021) | (points[:, 0] == 0.0))
    arm = cloud(points[beyond] @ FROM_ABOVE[:3, :3].T + FROM_ABOVE[:3, 3], tangents[beyond] @ FROM_ABOVE[:3, :3].T)
    group = [Instance(point_idx=np.arange(len(arm)), score=1.0)]
    for T, other in ((FROM_ABOVE, mirrored), (mirrored, FROM_ABOVE)):
        frame = at.look_at(at.placed(ELL, T), noise=SIGMA)
        (found,) = ESTIMATOR.estimate(arm, group, frame)
        assert_at(found, T)
        assert np.degrees(pose_error(found.T_cam_part, other, ELL).rotation) > 150


@pytest.mark.parametrize("extents", [(0.05, 0.03, 0.014), (0.06, 0.012, 0.012), (0.03, 0.03, 0.03)])
def test_another_part_is_not_verified(extents: tuple[float, float, float]) -> None:
    other = PartModel.from_mesh("box", trimesh.creation.box(extents))
    T = at.pose_of(other, LEANING[:3, :3])
    assert verified_in(scene_of(other, T)) == []


def test_points_at_random_are_not_verified() -> None:
    points = at.DISTANCE + np.random.default_rng(0).uniform(-0.03, 0.03, (300, 3)) - [at.DISTANCE, at.DISTANCE, 0.0]
    boundary = cloud(points, np.tile([1.0, 0.0, 0.0], (300, 1)))
    group = [Instance(point_idx=np.arange(300), score=1.0)]
    assert ESTIMATOR.estimate(boundary, group, at.look_at()) == []
    assert ESTIMATOR.estimate_scene(boundary, at.look_at()) == []


# How sure


def test_the_margin_is_the_lead_over_poses_that_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(ELL, LEANING, clutter=300)  # votes for many poses
    group = [Instance(point_idx=np.arange(len(scene.boundary)), score=1.0)]
    judged: list[tuple[Floats, float]] = []
    verify = hypothesis_scoring.verify

    searching = quick_estimator(ELL, replace(CONFIG, sure=1.0))

    def noted(T: Floats, edges: Any, *rest: Any) -> Any:
        verdict = verify(T, edges, *rest)
        if edges is searching.appearances:  # all of them, unlike for the score drop
            judged.append((T, verdict.logit))
        return verdict

    monkeypatch.setattr(hypothesis_scoring, "verify", noted)
    (found,) = searching.estimate_groups(scene.boundary, group, scene.frame)
    assert found is not None
    quick = judged[:-1]
    finalist = max(range(len(quick)), key=lambda k: quick[k][1])  # its refined pose has taken its place
    others = quick[:finalist] + quick[finalist + 1 :]
    far = [e for T, e in others if np.degrees(pose_error(T, found.T_cam_part, ELL).rotation) > 15.1]
    near = [e for T, e in judged if pose_error(T, found.T_cam_part, ELL).translation < 0.001]
    assert len(far) > 3
    assert found.verdict.logit == max(near)
    assert found.margin == found.verdict.logit - max(far) > 0
    alone = quick_estimator(ELL, replace(CONFIG, hypotheses=1, most_hypotheses=1))
    (only,) = alone.estimate_groups(scene.boundary, group, scene.frame)
    assert only is not None
    assert only.margin == np.inf


def test_the_score_is_the_confidence() -> None:
    sureness = ConfidenceConfig(margin=0.7, score_drop=0.3, size=0.4, bias=-8.0)
    other = quick_estimator(ELL, replace(CONFIG, confidence=sureness))
    for found in (*groups_of(BOTH, other), *other.estimate_scene(SEEN.boundary, SEEN.frame)):
        assert found is not None
        assert found.score == confidence(found.verdict, found.margin, found.score_drop, found.size, sureness)
    sizes = [len(one.point_idx) for one in BOTH.groups()]
    for found, size in zip(groups_of(BOTH, other), sizes, strict=True):
        assert found is not None
        assert 0.1 * size < found.size < 0.4 * size  # the wires are sampled finely


def test_rivals_with_nearly_the_same_surface_lower_the_score_alone() -> None:
    sureness = ConfidenceConfig(bias=-2.0, margin=0.5, close_margin=2.0)
    everywhere = quick_estimator(ELL, replace(CONFIG, confidence=sureness))
    nowhere = quick_estimator(ELL, replace(CONFIG, confidence=sureness))
    everywhere._models.same_surface.of = lambda T, others: np.ones(len(others), np.bool_)  # type: ignore[method-assign]
    nowhere._models.same_surface.of = lambda T, others: np.zeros(len(others), np.bool_)  # type: ignore[method-assign]
    scene = scene_of(ELL, PAIR[1], hiders=[PLATE])
    (same,), (other,) = groups_of(scene, everywhere), groups_of(scene, nowhere)
    assert same is not None
    assert other is not None
    size = max(same.size, 1)
    assert same.score == other.score
    assert same.surface_score == confidence(same.verdict, np.inf, np.inf, size, sureness)
    assert other.surface_score == confidence(other.verdict, other.margin, np.inf, size, sureness)


# What is kept


def test_two_groups_of_one_part_are_one_pose() -> None:
    shares = np.random.default_rng(0).permutation(len(SEEN.boundary)) % 2
    halves = [Instance(point_idx=np.flatnonzero(shares == k), score=1.0) for k in range(2)]
    found = ESTIMATOR.estimate_groups(SEEN.boundary, halves, SEEN.frame)
    for one in found:
        assert_at(one, LEANING)
    (kept,) = ESTIMATOR.estimate(SEEN.boundary, halves, SEEN.frame)
    assert kept.score == max(one.score for one in found if one is not None)


def test_only_poses_with_the_score_are_verified_best_first() -> None:
    def scored(score: float, x: float) -> PoseEstimate:
        (found,) = verified_in(SEEN)
        return replace(found, T_cam_part=make_transform(None, (x, 0.0, 0.0)) @ LEANING, score=score)

    estimates = [scored(0.49, 0.0), None, scored(0.5, 0.1), scored(0.9, 0.2), scored(0.8, 0.2)]
    assert [one.score for one in ESTIMATOR.verified(estimates)] == [0.9, 0.5]
    strict = quick_estimator(ELL, replace(CONFIG, min_score=0.95))
    assert strict.verified(estimates) == []
    lax = quick_estimator(ELL, replace(CONFIG, min_score=0.0))
    assert [one.score for one in lax.verified(estimates)] == [0.9, 0.5, 0.49]


def test_a_group_too_small_for_a_pair_has_no_pose() -> None:
    groups = [Instance(point_idx=np.arange(count), score=1.0) for count in (0, 1)]
    found = ESTIMATOR.estimate_groups(SEEN.boundary, [groups[0], *SEEN.groups(), groups[1]], SEEN.frame)
    assert (found[0], found[2]) == (None, None)
    assert_at(found[1], LEANING)
    assert found[1].instance_idx == 1  # type: ignore[union-attr]


def test_an_empty_scene_has_no_poses() -> None:
    nothing = [Instance(point_idx=np.arange(0), score=1.0)] * 2
    blind = at.framed(np.zeros((60, 80), np.float32))
    for frame in (SEEN.frame, blind):
        assert ESTIMATOR.estimate_groups(EMPTY, nothing, frame) == [None, None]
        assert ESTIMATOR.estimate(EMPTY, nothing, frame) == []
        assert ESTIMATOR.estimate_scene(EMPTY, frame) == []
    assert ESTIMATOR.estimate(SEEN.boundary, [], SEEN.frame) == []


# Sameness


def bits(estimates: list[PoseEstimate | None]) -> list[tuple[bytes, float]]:
    return [(one.T_cam_part.tobytes(), one.score) for one in estimates if one is not None]


def test_the_same_scene_gives_the_same_bits() -> None:
    first = bits(groups_of(BOTH))
    assert len(first) == 2
    assert bits(groups_of(BOTH)) == first
    assert bits(groups_of(BOTH, quick_estimator(at.ell()))) == first
    alone = ESTIMATOR.estimate_groups(BOTH.boundary, BOTH.groups()[::-1], BOTH.frame)
    assert bits(alone[::-1]) == first  # the order of the groups does not matter
    scenes = [ESTIMATOR.estimate_scene(BOTH.boundary, BOTH.frame) for _ in range(2)]
    assert bits(list(scenes[0])) == bits(list(scenes[1]))


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_the_number_of_threads_does_not_matter(threads: int) -> None:
    first = bits(groups_of(BOTH))
    with use_threads(threads):
        assert bits(groups_of(BOTH)) == first


def test_the_scene_is_not_changed() -> None:
    before = SEEN.boundary.points_cam.copy(), SEEN.boundary.tangents_cam.copy(), SEEN.frame.depth.copy()
    groups_of(SEEN)
    ESTIMATOR.estimate_scene(SEEN.boundary, SEEN.frame)
    for have, want in zip(
        (SEEN.boundary.points_cam, SEEN.boundary.tangents_cam, SEEN.frame.depth), before, strict=True
    ):
        np.testing.assert_array_equal(have, want)


def test_a_half_turn_of_the_camera_turns_the_pose() -> None:
    turn = rotation_about((0.0, 0.0, 1.0), np.pi)
    scene = scene_of(ELL, FROM_ABOVE)
    points, tangents = scene.boundary.points_cam @ turn.T, scene.boundary.tangents_cam @ turn.T
    K = scene.frame.K.copy()
    K[:2, 2] = np.array(at.SIZE) - 1 - K[:2, 2]
    frame = Frame(grey=scene.frame.grey, depth=scene.frame.depth[::-1, ::-1].copy(), K=K, T_world_cam=np.eye(4))
    (before,), (after,) = groups_of(scene), ESTIMATOR.estimate_groups(cloud(points, tangents), scene.groups(), frame)
    assert before is not None
    assert_at(after, make_transform(turn) @ before.T_cam_part, 5e-5, 0.05)


@pytest.mark.parametrize("seed", range(3))
def test_a_moved_scene_moves_the_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion = make_transform(rotation_about(rng.normal(size=3), 0.4), rng.uniform(-0.01, 0.01, 3))
    motion[:3, 3] += LEANING[:3, 3] - motion[:3, :3] @ LEANING[:3, 3]
    (before,), (after,) = (groups_of(scene_of(ELL, T, noise=0.0)) for T in (LEANING, motion @ LEANING))
    assert before is not None
    assert_at(after, motion @ before.T_cam_part, 0.0003, 0.3)


# Settings


def test_as_many_hypotheses_are_refined_as_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[float, ...]] = []
    refine = hypothesis_scoring.refine_edges

    def counted(T: Floats, model: Any, boundary: Any, config: Any) -> Any:
        asked.append(config.gates)
        return refine(T, model, boundary, config)

    monkeypatch.setattr(hypothesis_scoring, "refine_edges", counted)
    numbers = {"rough_hypotheses": 6, "hypotheses": 2, "most_hypotheses": 5, "finalists": 2, "scene_hypotheses": 3}
    config = replace(CONFIG, **numbers, contending=np.inf, sure=1.0)
    scene = scene_of(ELL, LEANING, clutter=300)  # votes for many poses
    group = [Instance(point_idx=np.arange(len(scene.boundary)), score=1.0)]
    for sure, looked_at in ((1.0, 5), (0.1, 2)):
        asked.clear()
        quick_estimator(ELL, replace(config, sure=sure)).estimate_groups(scene.boundary, group, scene.frame)
        coarse = [config.rough_edges.gates] * 6 + [config.quick_edges.gates] * looked_at
        assert asked == coarse + [config.edge_refinement.gates] * 2
    asked.clear()
    quick_estimator(ELL, config).estimate_scene(scene.boundary, scene.frame)
    assert asked == [config.edge_refinement.gates] * 3


def test_the_parts_models_are_made_with_the_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = EstimatorConfig()
    changed = replace(plain, edges=replace(plain.edges, thinning=0.05), pairs=replace(plain.pairs, distance_step=0.1))
    coarse = quick_estimator(ELL, changed)
    assert len(coarse.table.points) < len(ESTIMATOR.table.points)
    assert len(coarse.appearances.points) < 0.7 * len(ESTIMATOR.appearances.points)
    assert coarse.part is ELL
    monkeypatch.setattr(module, "edge_appearances", lambda part, config: ESTIMATOR.appearances)
    assert PoseEstimator(ELL).config == plain


def test_nonsense_in_an_estimate_is_refused() -> None:
    (found,) = verified_in(SEEN)
    with pytest.raises(ValueError, match=r"T_cam_part must be \(4, 4\), got \(3, 4\)"):
        replace(found, T_cam_part=np.eye(4)[:3])
    for score in (-0.1, 1.1, np.nan):
        for name in ("score", "surface_score"):
            with pytest.raises(ValueError, match=rf"^{name} must be in \[0, 1\], got {score}"):
                replace(found, **{name: score})


def test_a_frame_without_depth_is_refused() -> None:
    blind = at.framed(np.zeros((180, 240), np.float32))
    with pytest.raises(ValueError, match="the frame must have a depth somewhere"):
        ESTIMATOR.estimate(SEEN.boundary, SEEN.groups(), blind)
    with pytest.raises(ValueError, match="the frame must have a depth somewhere"):
        ESTIMATOR.estimate_scene(SEEN.boundary, blind)


def test_a_part_turned_inside_out_is_refused() -> None:
    mesh = ELL.mesh.copy()
    mesh.invert()
    with pytest.raises(ValueError, match="the mesh of 'inside out' must enclose a volume"):
        PoseEstimator(replace(ELL, name="inside out", mesh=mesh))
