"""Impossible poses are not found: blocks in each other, below the floor or in a wall; and the score drop."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from perception.frame import Frame, Workspace
from perception.geometry import Floats, make_transform, random_rotation, rotation_about
from perception.instance import Instance
from perception.metrics.pose_errors import pose_error
from perception.pose import estimator as module
from perception.pose import hypothesis_scoring
from perception.pose.estimator import PoseEstimator
from perception.pose.hypothesis_scoring import HypothesisScorer, ScoredHypothesis
from perception.pose.model.near_symmetry import NearSymmetryConfig, near_symmetries
from perception.pose.model.surface_models import surface_model
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.selection.bodies import BodyConfig
from perception.pose.verification.confidence import confidence
from tests.perception.pose import observed_part as at
from tests.perception.pose.estimator_scene import CONFIG, Scene, quick_estimator, scene_of

ELL = at.ell()
ESTIMATOR = quick_estimator(ELL)
OVER = rotation_about((1.0, 0.0, 0.0), np.pi)
FROM_ABOVE = at.pose_of(ELL, OVER)
LEANING = at.pose_of(ELL, rotation_about((1.0, 1.0, 0.0), 0.7) @ OVER)
T_WORLD_CAM = make_transform(random_rotation(np.random.default_rng(31)), (1.0, -2.0, 3.0))
PLATE = trimesh.creation.box((0.2, 0.2, 0.002), make_transform(None, (0.1, 0.0, 0.42)))  # before half of the image


def shifted(T: Floats, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Floats:
    return make_transform(None, (x, y, z)) @ T


def turned(T: Floats, angle: float) -> Floats:
    """Return a pose turned about the optical axis, which the part's centre is on."""
    return make_transform(rotation_about((0.0, 0.0, 1.0), angle)) @ T


# A block that leans into the one below it and hides a part of it.
DEEP = shifted(turned(FROM_ABOVE, 0.3), x=-0.022), shifted(turned(LEANING, 2.3), x=0.022, y=0.01, z=-0.01)
CROSSED = turned(FROM_ABOVE, 0.3), shifted(turned(FROM_ABOVE, 1.8), z=-0.01)


def bin_with_floor_at(depth: float, width: float = 0.4) -> Workspace:
    """Return a bin that the camera looks straight down into, its floor at a depth."""
    T_cam_bin = make_transform(OVER, (0.0, 0.0, depth))
    return Workspace(T_world_bin=T_WORLD_CAM @ T_cam_bin, inner_size=np.array([width, 0.4, 0.3]))


def within(workspace: Workspace, **changes: Any) -> PoseEstimator:
    """Return an estimator that knows the bin; everything else is made already."""
    known = quick_estimator(ELL, replace(CONFIG, **changes))
    known.workspace = workspace
    return known


def turned_world(scene: Scene) -> Frame:
    return replace(scene.frame, T_world_cam=T_WORLD_CAM)


def all_points(scene: Scene) -> list[Instance]:
    return [Instance(point_idx=np.arange(len(scene.boundary)), score=1.0)]


def groups_of(scene: Scene, estimator: PoseEstimator = ESTIMATOR) -> list[PoseEstimate | None]:
    return estimator.estimate_groups(scene.boundary, scene.groups(), turned_world(scene))


def is_at(found: PoseEstimate | None, T: Floats) -> bool:
    if found is None:
        return False
    error = pose_error(found.T_cam_part, T, ELL)
    return bool(error.translation < 0.001 and np.degrees(error.rotation) < 1)


def lowest(T_cam_part: Floats) -> float:
    """Return the largest depth of a part's corners [m]."""
    return float((np.asarray(ELL.mesh.vertices) @ T_cam_part[2, :3]).max() + T_cam_part[2, 3])


# The bin


def test_a_pose_that_the_bin_has_room_for_is_found() -> None:
    scene = scene_of(ELL, LEANING)
    for depth in (at.FLOOR, lowest(LEANING) + 0.001, lowest(LEANING) - 0.002):  # a right pose may be off a little
        (found,) = groups_of(scene, within(bin_with_floor_at(depth)))
        assert is_at(found, LEANING)


def test_a_pose_below_the_floor_is_never_found_but_the_next_best() -> None:
    scene = scene_of(ELL, LEANING, clutter=300)  # votes for many poses
    frame, floor = turned_world(scene), lowest(LEANING) - 0.01
    free, bound = quick_estimator(ELL), within(bin_with_floor_at(floor))
    (unbound,) = free.estimate_groups(scene.boundary, all_points(scene), frame)
    assert is_at(unbound, LEANING)
    (found,) = bound.estimate_groups(scene.boundary, all_points(scene), frame)
    assert found is not None
    assert not is_at(found, LEANING)
    assert lowest(found.T_cam_part) <= floor + CONFIG.bodies.protrusion * ELL.d_max
    for one in bound.estimate_scene(scene.boundary, frame):
        assert lowest(one.T_cam_part) <= floor + CONFIG.bodies.protrusion * ELL.d_max
    assert any(is_at(one, LEANING) for one in free.estimate_scene(scene.boundary, frame))


def test_a_group_has_no_pose_where_the_bin_has_no_room_at_all() -> None:
    scene = scene_of(ELL, LEANING)
    above = within(bin_with_floor_at(0.3))
    assert groups_of(scene, above) == [None]
    assert above.estimate(scene.boundary, scene.groups(), turned_world(scene)) == []
    assert above.estimate_scene(scene.boundary, turned_world(scene)) == []


def test_a_refinement_that_leads_below_the_floor_is_not_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first, rough refinement stays; the last one, here off by 20 mm, is left."""
    scene = scene_of(ELL, LEANING)
    known = within(bin_with_floor_at(lowest(LEANING) + 0.001))
    refine_fully = HypothesisScorer.refine_fully

    def led_astray(scorer: HypothesisScorer, T: Floats) -> ScoredHypothesis:
        refined = refine_fully(scorer, T)
        return replace(refined, T_cam_part=shifted(refined.T_cam_part, z=0.02))

    monkeypatch.setattr(HypothesisScorer, "refine_fully", led_astray)
    (found,) = groups_of(scene, known)
    assert found is not None
    assert pose_error(found.T_cam_part, LEANING, ELL).translation < 0.002


@pytest.mark.parametrize(("offset", "possible"), [(-0.001, True), (0.001, False)])
def test_a_part_may_reach_through_the_floor_or_a_wall_by_a_share_of_its_size(offset: float, possible: bool) -> None:
    frame = turned_world(scene_of(ELL, FROM_ABOVE))
    known = within(bin_with_floor_at(0.5, width=0.1), bodies=BodyConfig(protrusion=0.1))
    through = 0.1 * ELL.d_max + offset
    right = float((np.asarray(ELL.mesh.vertices) @ FROM_ABOVE[0, :3]).max())
    inside = shifted(FROM_ABOVE, z=0.47 - lowest(FROM_ABOVE))
    penalty = 0.0 if possible else np.inf
    assert known.penalty(inside, frame) == 0
    assert known.penalty(shifted(inside, z=0.03 + through), frame) == penalty
    assert known.penalty(shifted(inside, x=0.05 + through - right - FROM_ABOVE[0, 3]), frame) == penalty
    assert ESTIMATOR.penalty(shifted(inside, z=9.0), frame) == 0  # nothing is known of any bin


def test_where_the_bins_place_is_uncertain_the_penalty_grows_with_the_penetration() -> None:
    frame = turned_world(scene_of(ELL, FROM_ABOVE))
    unsure = replace(bin_with_floor_at(0.5, width=0.1), translation_std=0.004)
    known = within(unsure, bodies=BodyConfig(protrusion=0.1))
    allowed = shifted(FROM_ABOVE, z=0.5 - lowest(FROM_ABOVE) + 0.1 * ELL.d_max)
    penalties = [known.penalty(shifted(allowed, z=deeper), frame) for deeper in (0.0, 0.004, 0.008, 0.0165)]
    assert penalties == [
        pytest.approx(0.0, abs=1e-9),
        pytest.approx(0.5),
        pytest.approx(2.0),
        np.inf,
    ]  # (z / std)^2 / 2, up to four of them
    centre = (allowed[:3, :3] @ ELL.centre + allowed[:3, 3] + (0, 0, 0.004)) @ T_WORLD_CAM[:3, :3].T + T_WORLD_CAM[
        :3, 3
    ]
    lever = np.linalg.norm(centre - unsure.T_world_bin[:3, 3])
    turned = within(replace(unsure, translation_std=0.0, rotation_std=0.004 / lever), bodies=BodyConfig(protrusion=0.1))
    assert turned.penalty(shifted(allowed, z=0.004), frame) == pytest.approx(0.5)


def test_a_right_pose_in_a_bin_that_is_believed_too_high_is_found_with_a_lower_score() -> None:
    scene = scene_of(ELL, LEANING)
    (right,) = groups_of(scene, within(bin_with_floor_at(lowest(LEANING) + 0.001)))
    high = bin_with_floor_at(lowest(LEANING) - 0.01)
    assert not is_at(groups_of(scene, within(high))[0], LEANING)
    (found,) = groups_of(scene, within(replace(high, translation_std=0.01)))
    assert is_at(found, LEANING)
    assert 0.5 < found.score < right.score
    odds = [each.score / (1 - each.score) for each in (right, found)]
    assert odds[0] / odds[1] < np.exp(0.5)
    sure, unsure = (
        within(each).estimate_scene(scene.boundary, turned_world(scene))[0]
        for each in (bin_with_floor_at(lowest(LEANING) + 0.001), replace(high, translation_std=0.01))
    )
    assert is_at(unsure, LEANING)
    assert unsure.score < sure.score


def test_what_the_bin_takes_off_a_pose_also_narrows_its_margin_over_others() -> None:
    scene = scene_of(ELL, LEANING)
    group = ESTIMATOR._thinned_group(scene.boundary, ESTIMATOR._index(scene.boundary), scene.frame, 0.0)
    scorer = HypothesisScorer(ESTIMATOR._models, group, ESTIMATOR.config)
    right, rival = (scorer.refine_coarsely(T) for T in (LEANING, shifted(LEANING, x=0.02)))
    free, penalised = (scorer.estimate(replace(right, penalty=p), [rival], 9.0, 0) for p in (0.0, 0.5))
    assert free.margin - penalised.margin == pytest.approx(0.5)


def test_the_bin_is_given_when_an_estimator_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "edge_appearances", lambda part, config: ESTIMATOR.appearances)
    workspace = bin_with_floor_at(0.5)
    assert PoseEstimator(ELL, CONFIG, workspace).workspace is workspace
    assert PoseEstimator(ELL, CONFIG).workspace is None


# Each other


def test_of_two_poses_that_collide_the_better_is_selected_and_the_other_group_gets_its_next_best() -> None:
    assert ESTIMATOR.clash(*DEEP)
    lax = quick_estimator(ELL, replace(CONFIG, bodies=BodyConfig(overlap=0.99)))
    scene = scene_of(ELL, *DEEP)
    alone = groups_of(scene, lax)
    assert [is_at(found, T) for found, T in zip(alone, DEEP, strict=True)] == [True, True]
    assert alone[1].score > alone[0].score  # type: ignore[union-attr]
    first, second = groups_of(scene)
    assert is_at(second, DEEP[1])
    assert first is not None
    assert not ESTIMATOR.clash(first.T_cam_part, DEEP[1])
    assert first.verdict.logit < alone[0].verdict.logit  # type: ignore[union-attr]
    assert first.instance_idx == 0


def test_a_group_all_of_whose_poses_collide_with_one_of_a_higher_score_has_none() -> None:
    scene = scene_of(ELL, *CROSSED)
    assert ESTIMATOR.clash(*CROSSED)
    for order in (1, -1):
        groups = scene.groups()[::order]
        found = ESTIMATOR.estimate_groups(scene.boundary, groups, turned_world(scene))[::order]
        assert found[0] is None
        assert is_at(found[1], CROSSED[1])


def test_a_pose_with_a_low_score_rules_nothing_out() -> None:
    scene = scene_of(ELL, *DEEP)
    unsure = groups_of(scene, quick_estimator(ELL, replace(CONFIG, min_score=1.0)))
    assert [is_at(found, T) for found, T in zip(unsure, DEEP, strict=True)] == [True, True]


def test_poses_that_overlap_collide_unless_they_are_alike() -> None:
    here = FROM_ABOVE
    assert not ESTIMATOR.clash(here, here)
    near = at.beside(here, ELL, np.random.default_rng(0), 0.09 * ELL.d_max, np.deg2rad(14))
    depth = CONFIG.bodies.depth * ELL.d_max
    assert ESTIMATOR.body.overlap(here, near, depth) > CONFIG.bodies.overlap
    assert not ESTIMATOR.clash(here, near)  # two groups of one part
    for other in (shifted(here, x=0.03), turned(here, 1.0), shifted(here, z=0.011)):
        assert ESTIMATOR.clash(here, other)
        assert ESTIMATOR.clash(other, here)
        assert ESTIMATOR.clash(T_WORLD_CAM @ here, T_WORLD_CAM @ other)
    for other in (shifted(here, z=0.015), shifted(here, x=0.1)):  # one on the other, and beside it
        assert not ESTIMATOR.clash(here, other)


@pytest.mark.parametrize("bodies", [BodyConfig(overlap=0.9), BodyConfig(depth=0.3)])
def test_what_clashes_is_as_the_settings_say(bodies: BodyConfig) -> None:
    assert ESTIMATOR.clash(*DEEP)
    assert not quick_estimator(ELL, replace(CONFIG, bodies=bodies)).clash(*DEEP)


def test_verified_poses_do_not_collide_and_like_ones_are_one() -> None:
    (seen,) = groups_of(scene_of(ELL, LEANING))
    assert seen is not None

    def scored(score: float, T: Floats) -> PoseEstimate:
        return replace(seen, T_cam_part=T, score=score)  # type: ignore[type-var]

    far = shifted(DEEP[1], x=0.3)
    estimates = [scored(0.6, DEEP[0]), scored(0.9, DEEP[1]), None, scored(0.7, far), scored(0.8, shifted(far, y=0.004))]
    assert [one.score for one in ESTIMATOR.verified(estimates)] == [0.9, 0.8]
    without = [estimates[0], *estimates[2:]]
    assert [one.score for one in ESTIMATOR.verified(without)] == [0.8, 0.6]
    # A pose that is dropped drops no other: the third clashes with the second alone, which clashes with the first.
    chain = [scored(0.9 - 0.1 * k, shifted(FROM_ABOVE, z=0.008 * k)) for k in range(3)]
    clashes = [ESTIMATOR.clash(chain[a].T_cam_part, chain[b].T_cam_part) for a, b in ((0, 1), (1, 2), (0, 2))]
    assert clashes == [True, True, False]
    assert [one.score for one in ESTIMATOR.verified(chain)] == [chain[0].score, chain[2].score]


def test_another_least_score_may_be_asked_for() -> None:
    (seen,) = groups_of(scene_of(ELL, LEANING))
    assert seen is not None
    apart = ((0.0, 0.4), (0.2, 0.6), (0.4, 0.5))
    estimates = [replace(seen, T_cam_part=shifted(LEANING, x=x), score=score) for x, score in apart]
    assert [one.score for one in ESTIMATOR.verified(estimates)] == [0.6, 0.5]  # a pose with this very score is verified
    assert [one.score for one in ESTIMATOR.verified(estimates, 0.0)] == [0.6, 0.5, 0.4]
    assert [one.score for one in ESTIMATOR.verified(estimates, 0.6)] == [0.6]
    assert ESTIMATOR.verified(estimates, 0.61) == []


# Score drop and coarse refinement


def test_the_score_drop_under_perturbation_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    sureness = replace(CONFIG.confidence, score_drop=0.5, clear=2.0)
    judging = quick_estimator(ELL, replace(CONFIG, confidence=sureness))
    asked: list[Floats] = []

    def noted(T: Floats, perturbations: Floats, logit: Callable[[Floats], float]) -> float:
        drops = [logit(T) - logit(T @ motion) for motion in perturbations]
        assert len(drops) == 6
        assert min(drops) > 1  # all of the block is visible
        asked.append(T)
        return 1.25

    monkeypatch.setattr(hypothesis_scoring, "score_drop", noted)
    scene = scene_of(ELL, LEANING)
    for found in (*groups_of(scene, judging), *judging.estimate_scene(scene.boundary, turned_world(scene))[:1]):
        assert found is not None
        assert found.score_drop == 1.25
        assert any(np.array_equal(found.T_cam_part, T) for T in asked)
        assert found.score == confidence(found.verdict, found.margin, 1.25, found.size, sureness)


@pytest.mark.parametrize("seed", range(3))
def test_the_score_drops_less_when_half_is_occluded(seed: int) -> None:
    T = at.random_pose(ELL, np.random.default_rng(seed))
    (whole,), (half,) = groups_of(scene_of(ELL, T)), groups_of(scene_of(ELL, T, hiders=[PLATE]))
    assert whole is not None
    assert half is not None
    assert 0 < half.score_drop < whole.score_drop < np.inf


def test_the_coarse_refinement_uses_fewer_points(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, float, bool]] = []
    refine_edges, refine_surface = hypothesis_scoring.refine_edges, hypothesis_scoring.refine_surface
    refine_jointly = hypothesis_scoring.refine_jointly

    def edges(T: Floats, model: Any, boundary: Any, config: Any) -> Any:
        asked.append((len(model.points), 0.0, config.gates in coarse))
        return refine_edges(T, model, boundary, config)

    def surface(T: Floats, model: Any, frame: Any, config: Any) -> Any:
        asked.append((0, model.spacing, config.gates == looking.config.quick_surface.gates))
        return refine_surface(T, model, frame, config)

    def jointly(T: Floats, model: Any, surfaces: Any, group: Any, config: Any) -> Any:
        asked.append((len(model.points), surfaces.spacing, False))
        return refine_jointly(T, model, surfaces, group, config)

    monkeypatch.setattr(hypothesis_scoring, "refine_edges", edges)
    monkeypatch.setattr(hypothesis_scoring, "refine_surface", surface)
    monkeypatch.setattr(hypothesis_scoring, "refine_jointly", jointly)
    numbers = {"rough_hypotheses": 1, "hypotheses": 1, "most_hypotheses": 1}
    looking = quick_estimator(ELL, replace(CONFIG, quick_step=3, quick_spacing=0.1, **numbers))
    coarse = looking.config.rough_edges.gates, looking.config.quick_edges.gates
    groups_of(scene_of(ELL, LEANING), looking)
    few, all_of_them = len(looking.appearances.every(3).points), len(looking.appearances.points)
    assert asked[:3] == [(few, 0.0, True), (few, 0.0, True), (0, pytest.approx(0.1 * ELL.d_max), True)]
    assert asked[3:5] == [(all_of_them, 0.0, False), (all_of_them, pytest.approx(0.03 * ELL.d_max), False)]


def test_nonsense_in_the_coarse_refinement_is_refused() -> None:
    with pytest.raises(ValueError, match="quick_step must be at least 1, got 0"):
        replace(CONFIG, quick_step=0)
    with pytest.raises(ValueError, match="spacing must be between 0 and 1, got 0"):
        quick_estimator(ELL, replace(CONFIG, quick_spacing=0.0))


def test_poses_beside_each_other_keep_their_bits_in_another_world() -> None:
    """Without a bin, where the camera is does not matter."""
    scene = scene_of(ELL, DEEP[0], shifted(DEEP[1], z=-0.01))
    here = ESTIMATOR.estimate_groups(scene.boundary, scene.groups(), scene.frame)
    there = groups_of(scene)
    for one, other in zip(here, there, strict=True):
        assert one is not None
        assert other is not None
        assert one.T_cam_part.tobytes() == other.T_cam_part.tobytes()
        assert (one.score, one.score_drop) == (other.score, other.score_drop)


def test_a_pose_that_was_ruled_out_does_not_come_back_as_near_symmetric_to_the_next_best() -> None:
    scene = scene_of(ELL, *DEEP)
    every_near_symmetry = quick_estimator(ELL, replace(CONFIG, near_symmetry=NearSymmetryConfig(lead=50.0)))
    first, second = groups_of(scene, every_near_symmetry)
    assert is_at(second, DEEP[1])
    assert first is None or not every_near_symmetry.clash(first.T_cam_part, DEEP[1])
    assert len(every_near_symmetry.estimate(scene.boundary, scene.groups(), turned_world(scene))) == 2


@pytest.mark.parametrize(("most", "found"), [(3, True), (0, False)])
def test_the_near_symmetric_pose_is_tried(most: int, found: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    motion = near_symmetries(ELL, surface_model(ELL))[0]
    estimator = quick_estimator(ELL, replace(CONFIG, near_symmetry=NearSymmetryConfig(most=most, lead=50.0)))
    # The votes give nothing but the pose that is near-symmetric to the truth.
    monkeypatch.setattr(estimator, "_hypotheses", lambda group, count: (LEANING @ np.linalg.inv(motion))[None])
    scene = scene_of(ELL, LEANING)
    assert is_at(groups_of(scene, estimator)[0], LEANING) == found
