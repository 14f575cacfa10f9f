"""Plates side by side, in pieces, occluded and on top of each other; the claims against their plain twin."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.boundary import BoundaryCloud
from perception.geometry import Floats, make_transform
from perception.instance import Instance, labels_of
from perception.part import PartModel
from perception.pose.model.surface_models import surface_model
from perception.pose.selection.explanation import ExplanationConfig, claimed_points, explain_segments
from tests.perception.pose import observed_part as at
from tests.reference import explanation_twin as twin

SIDE, THICK, DEPTH = 0.04, 0.008, 0.5  # of a plate, and of its upper face's place before the camera [m]
PLATE = PartModel.from_mesh("plate", trimesh.creation.box((SIDE, SIDE, THICK)))
SURFACE, COARSE = surface_model(PLATE), surface_model(PLATE, 0.06)
CONFIG = ExplanationConfig(min_points=20)
RIM = 60  # points of a plate's rim
NEXT = SIDE + 0.006  # place of a neighbour: beyond the reach of a surface's samples, 0.05 d_max [m]


@dataclass(frozen=True, kw_only=True)
class Pose:
    T_cam_part: Floats
    score: float = 0.9


def plate(x: float, y: float = 0.0, z: float = 0.0, score: float = 0.9) -> Pose:
    """A plate whose upper face lies ``z`` behind DEPTH."""
    return Pose(T_cam_part=make_transform(None, np.array([x, y, DEPTH + THICK / 2 + z])), score=score)


def rim(x: float, y: float = 0.0, z: float = 0.0) -> Floats:
    """Return (RIM, 3) points just inside the outline of a plate's upper face."""
    t = np.linspace(-0.48, 0.48, RIM // 4) * SIDE
    end = np.full_like(t, 0.48 * SIDE)
    u, v = np.concatenate([t, t, end, -end]), np.concatenate([end, -end, t, t])
    return np.column_stack([x + u, y + v, np.full(RIM, DEPTH + z)])


def cloud(*points: Floats) -> BoundaryCloud:
    """A boundary cloud of which only the points matter."""
    points_cam = np.concatenate(points)
    n = len(points_cam)
    return BoundaryCloud(
        points_cam=points_cam,
        tangents_cam=np.zeros((n, 3)),
        linearity=np.zeros(n),
        pixels=np.column_stack([np.arange(n), np.zeros(n, np.int64)]),
    )


def group(first: int, end: int, score: float = 0.8) -> Instance:
    return Instance(point_idx=np.arange(first, end), score=score)


def spans(instances: list[Instance]) -> list[tuple[int, int, int]]:
    """First point, last point and number of points of each instance."""
    return [(int(i.point_idx[0]), int(i.point_idx[-1]), len(i.point_idx)) for i in instances]


def test_plates_in_one_group_come_apart() -> None:
    boundary = cloud(rim(0.0), rim(NEXT))
    found = explain_segments(boundary, [group(0, 2 * RIM)], [plate(NEXT, score=0.85), plate(0.0)], SURFACE, CONFIG)
    assert spans(found) == [(0, RIM - 1, RIM), (RIM, 2 * RIM - 1, RIM)]
    assert [one.score for one in found] == [0.9, 0.85]


def test_a_plate_in_pieces_comes_together() -> None:
    pieces = [group(0, 25), group(25, RIM, 0.6)]
    found = explain_segments(cloud(rim(0.0)), pieces, [plate(0.0, score=0.3)], SURFACE, CONFIG)
    assert spans(found) == [(0, RIM - 1, RIM)]
    assert found[0].score == pytest.approx((25 * 0.8 + 35 * 0.6) / RIM)


def test_what_a_pose_leaves_over_of_a_group_stays_a_group() -> None:
    boundary = cloud(rim(0.0), rim(NEXT))
    found = explain_segments(boundary, [group(0, 2 * RIM)], [plate(0.0)], SURFACE, CONFIG)
    assert spans(found) == [(0, RIM - 1, RIM), (RIM, 2 * RIM - 1, RIM)]
    assert found[1].score == pytest.approx(0.8 / 2)


def test_too_small_a_remainder_is_dropped() -> None:
    boundary = cloud(rim(0.0), rim(NEXT))
    for end, expected in ((RIM + 19, 1), (RIM + 20, 2)):
        found = explain_segments(boundary, [group(0, end)], [plate(0.0)], SURFACE, CONFIG)
        assert len(found) == expected


def test_a_pose_of_too_few_points_explains_nothing() -> None:
    boundary = cloud(rim(0.0)[:19], rim(NEXT))
    groups = [group(0, 19 + RIM)]
    assert spans(explain_segments(boundary, groups, [plate(0.0)], SURFACE, CONFIG)) == [(0, 18 + RIM, 19 + RIM)]
    few = replace(CONFIG, min_points=19)
    assert spans(explain_segments(boundary, groups, [plate(0.0)], SURFACE, few))[0] == (0, 18, 19)


def test_points_of_no_group_are_explained_even_without_any_group() -> None:
    found = explain_segments(cloud(rim(0.0)), [], [plate(0.0, score=0.4)], SURFACE, CONFIG)
    assert spans(found) == [(0, RIM - 1, RIM)]
    assert found[0].score == 0.4


@pytest.mark.parametrize(("share", "claimed"), [(-0.9, True), (0.9, True), (-1.1, False), (1.1, False)])
def test_the_distance_from_the_surface_decides(share: float, claimed: bool) -> None:
    # The sample nearest to a point is at most its spacing aside, so that a small weight leaves the plane's distance.
    config = replace(CONFIG, sideways=0.05)
    off = share * config.distance * PLATE.d_max
    claims = claimed_points(cloud(rim(0.0, z=off) * [0.9, 0.9, 1.0]), [plate(0.0).T_cam_part], SURFACE, config)
    assert (claims == (0 if claimed else -1)).all()


def test_a_point_aside_of_the_surface_is_not_explained() -> None:
    apart = cloud(rim(0.0) * [1.2, 1.2, 1.0])
    assert (claimed_points(apart, [plate(0.0).T_cam_part], SURFACE, CONFIG) == -1).all()


def test_a_side_that_is_turned_away_explains_nothing() -> None:
    below = cloud(rim(0.0, z=THICK))
    assert (claimed_points(below, [plate(0.0).T_cam_part], SURFACE, CONFIG) == -1).all()


@pytest.mark.parametrize("z", [-2 * DEPTH, -DEPTH, 0.001 - DEPTH])
def test_a_pose_behind_or_right_before_the_camera_explains_nothing(z: float) -> None:
    assert (claimed_points(cloud(rim(0.0)), [plate(0.0, z=z).T_cam_part], SURFACE, CONFIG) == -1).all()


def test_the_nearest_surface_has_a_point() -> None:
    gap = 0.0008  # of two upper faces in depth, both within reach
    poses = [plate(0.0, z=0.0).T_cam_part, plate(0.5 * SIDE, z=gap).T_cam_part]
    boundary = cloud(rim(0.0), rim(0.5 * SIDE, z=gap))
    config = replace(CONFIG, overlap=1.0, sideways=0.05)
    np.testing.assert_array_equal(claimed_points(boundary, poses, SURFACE, config), np.repeat([0, 1], RIM))


def test_of_equal_poses_the_better_one_has_the_points() -> None:
    poses = [plate(0.0, score=0.6), plate(0.0, score=0.7)]
    for overlap in (0.5, 1.0):
        found = explain_segments(cloud(rim(0.0)), [], poses, SURFACE, replace(CONFIG, overlap=overlap))
        assert [one.score for one in found] == [0.7]
        assert spans(found) == [(0, RIM - 1, RIM)]


def test_a_pose_that_says_again_what_a_better_one_says_is_left_out() -> None:
    # Half a millimetre nearer to the points, the second would take them all.
    better, again = plate(0.0, z=0.0005, score=0.9).T_cam_part, plate(0.0, score=0.8).T_cam_part
    boundary = cloud(rim(0.0))
    assert (claimed_points(boundary, [better, again], SURFACE, CONFIG) == 0).all()
    assert (claimed_points(boundary, [better, again], SURFACE, replace(CONFIG, overlap=1.0)) == 1).all()


def test_without_a_usable_pose_the_groups_stay_as_they_are() -> None:
    groups = [group(0, RIM), group(RIM, RIM + 5, 0.1)]
    poses = [None, plate(0.0, score=0.04)]
    for given_poses in ([], poses):
        found = explain_segments(cloud(rim(0.0), rim(NEXT)), groups, given_poses, SURFACE, CONFIG)
        assert all(a is b for a, b in zip(found, groups, strict=True))
    lower = replace(CONFIG, min_score=0.04)
    assert len(explain_segments(cloud(rim(0.0), rim(NEXT)), groups, poses, SURFACE, lower)) == 1


def test_an_empty_scene_has_no_segments() -> None:
    assert explain_segments(cloud(np.zeros((0, 3))), [], [plate(0.0)], SURFACE) == []


def test_arguments_are_not_changed() -> None:
    boundary, groups, poses = cloud(rim(0.0), rim(NEXT)), [group(0, 2 * RIM)], [plate(NEXT, score=0.1), plate(0.0)]
    before = boundary.points_cam.copy()
    explain_segments(boundary, groups, poses, SURFACE, CONFIG)
    np.testing.assert_array_equal(boundary.points_cam, before)
    assert spans(groups) == [(0, 2 * RIM - 1, 2 * RIM)]
    assert [pose.score for pose in poses] == [0.1, 0.9]


def random_scene(seed: int) -> tuple[BoundaryCloud, list[Pose]]:
    """Plates of any attitude close together and points about their surfaces, some of them far off."""
    rng = np.random.default_rng(seed)
    poses, points = [], [rng.uniform((-0.05, -0.05, 0.4), (0.05, 0.05, 0.6), (40, 3))]
    for _ in range(rng.integers(1, 5)):
        T = at.random_pose(PLATE, rng)
        T[:3, 3] += rng.uniform(-0.02, 0.02, 3)
        on = SURFACE.points[rng.integers(len(SURFACE.points), size=60)]
        points.append(on @ T[:3, :3].T + T[:3, 3] + 0.0008 * rng.normal(size=on.shape))
        poses.append(Pose(T_cam_part=T, score=float(rng.uniform(0.05, 1.0))))
    mixed = np.concatenate(points)
    return cloud(rng.permutation(mixed)), poses


@pytest.mark.parametrize("seed", [0, 1, 2, 4])
def test_claims_against_their_twin(seed: int) -> None:
    boundary, poses = random_scene(seed)
    transforms = [pose.T_cam_part for pose in poses]
    for config in (CONFIG, ExplanationConfig(min_points=5, distance=0.05, sideways=1.0, overlap=0.2)):
        claims = claimed_points(boundary, transforms, COARSE, config)
        np.testing.assert_array_equal(claims, twin.claimed_points(boundary.points_cam, transforms, COARSE, config))
        assert len(np.unique(claims)) > 1


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.integers(0, 6))
def test_segments_are_disjoint_ascending_and_ranked(seed: int, groups: int) -> None:
    boundary, poses = random_scene(seed)
    rng = np.random.default_rng(seed)
    labels = rng.integers(-1, max(groups, 1), len(boundary))
    given_groups = [Instance(point_idx=np.flatnonzero(labels == g), score=float(rng.random())) for g in range(groups)]
    found = explain_segments(boundary, given_groups, poses, SURFACE, CONFIG)
    scores = [one.score for one in found]
    assert scores == sorted(scores, reverse=True)
    assert all(0 <= score <= 1 for score in scores)
    assert all((np.diff(one.point_idx) > 0).all() and len(one.point_idx) >= CONFIG.min_points for one in found)
    assert sum(len(one.point_idx) for one in found) == np.count_nonzero(labels_of(found, len(boundary)) >= 0)


def test_nearly_right_poses_undo_mixed_groups() -> None:
    rng = np.random.default_rng(3)
    part = at.ell()
    poses = [at.random_pose(part, rng) for _ in range(2)]
    poses[1][0, 3] += 0.05
    surface, seen = surface_model(part), []
    for T in poses:
        shown = surface.points[surface.visible(T)]
        seen.append(shown @ T[:3, :3].T + T[:3, 3] + at.SIGMA * rng.normal(size=shown.shape))
    truth = np.repeat([0, 1], [len(s) for s in seen])
    mixed = rng.integers(0, 3, len(truth))
    groups = [Instance(point_idx=np.flatnonzero(mixed == g), score=0.9 - g / 10) for g in range(3)]
    nearly = [Pose(T_cam_part=at.beside(T, part, rng, 0.0005, 0.01), score=0.95 - k / 10) for k, T in enumerate(poses)]
    found = explain_segments(cloud(*seen), groups, nearly, surface, CONFIG)
    assert np.mean(labels_of(found, len(truth)) == truth) > 0.98


def test_nonsense_is_refused() -> None:
    boundary = cloud(rim(0.0))
    for outside in (np.array([3, RIM]), np.array([-1, 3])):
        expected = f"instance 1 must have point indices 0 to {RIM - 1}, got {outside[0]} to {outside[1]}"
        with pytest.raises(ValueError, match=expected):
            explain_segments(boundary, [group(0, 3), Instance(point_idx=outside, score=0.5)], [], SURFACE)
    with pytest.raises(ValueError, match=r"T_cam_part must be .*, got \(3, 3\)"):
        explain_segments(boundary, [], [Pose(T_cam_part=np.eye(3))], SURFACE)
    with pytest.raises(ValueError, match="T_cam_part must be finite"):
        explain_segments(boundary, [], [Pose(T_cam_part=np.full((4, 4), np.nan))], SURFACE)


@pytest.mark.parametrize(
    ("settings_", "message"),
    [
        ({"min_score": 1.1}, r"min_score must be in \[0, 1\], got 1.1"),
        ({"distance": 0.0}, "distance must be positive, got 0.0"),
        ({"distance": np.inf}, "distance must be positive, got inf"),
        ({"sideways": 0.0}, r"sideways must be in \(0, 1\], got 0.0"),
        ({"overlap": 1.5}, r"overlap must be in \(0, 1\], got 1.5"),
        ({"min_points": 0}, "min_points must be at least 1, got 0"),
    ],
)
def test_nonsense_settings_are_refused(settings_: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ExplanationConfig(**settings_)  # type: ignore[arg-type]
