"""Right and wrong poses of a block before a depth image, and the compiled kernels against their plain twins."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
import trimesh

from perception.frame import Frame
from perception.geometry import Floats, make_transform, rotation_about
from perception.part import PartModel
from perception.pose.model import _surface_kernels as surface_kernels
from perception.pose.model.surface_models import surface_model
from perception.pose.verification import _refine_kernels as kernels
from perception.pose.verification import _verification_kernels as verification_kernels
from perception.pose.verification.boundary_index import BoundaryIndex, index_boundary
from perception.pose.verification.verification import (
    ObservedGroup,
    Verdict,
    VerificationConfig,
    edge_scores,
    ranking_logit,
    verify,
)
from tests.perception.pose import observed_part as at
from tests.perception.pose.observed_part import SIGMA, K
from tests.reference import refine_twin as twin

ELL = at.ell()
MODEL = at.wire_model(ELL)
SURFACE = surface_model(ELL)
CONFIG = VerificationConfig()
OVER = rotation_about((1.0, 0.0, 0.0), np.pi)
FROM_ABOVE = at.pose_of(ELL, OVER)
LEANING = at.pose_of(ELL, rotation_about((1.0, 1.0, 0.0), 0.7) @ OVER)
GROUP = at.wire_scene(LEANING, ELL, np.random.default_rng(0))
BOUNDARY = index_boundary(*GROUP, ELL.d_max)
SEEN = at.look_at(at.placed(ELL, LEANING), noise=SIGMA)
FLOOR = at.look_at()  # and nothing on it


def observed(frame: Frame, group: tuple[Floats, Floats], boundary: BoundaryIndex = BOUNDARY) -> ObservedGroup:
    return ObservedGroup(points_cam=group[0], tangents_cam=group[1], boundary=boundary, frame=frame)


def verdict(T: Floats, frame: Frame = SEEN, boundary_at: Floats = LEANING) -> Verdict:
    group = at.wire_scene(boundary_at, ELL, np.random.default_rng(0))
    return verify(T, MODEL, SURFACE, observed(frame, group, index_boundary(*group, ELL.d_max)))


def scores(T: Floats, points: Floats, tangents: Floats, frame: Frame = FLOOR, **change: float) -> tuple[float, float]:
    """Return the edge scores of a pose when these boundary points are all there is."""
    index = index_boundary(points, tangents, ELL.d_max)
    return edge_scores(T, MODEL, observed(frame, (points, tangents), index), replace(CONFIG, **change))  # type: ignore[arg-type]


def lifted(T: Floats, height: float) -> Floats:
    """Return a pose moved towards the camera along the line of sight of its centre."""
    return make_transform(None, (0.0, 0.0, -height)) @ T


@pytest.mark.parametrize("T", [LEANING, FROM_ABOVE], ids=["leaning", "from above"])
def test_the_true_pose_has_everything_for_it(T: Floats) -> None:
    for noise in (0.0, SIGMA):
        found = verdict(T, at.look_at(at.placed(ELL, T), noise=noise), T)
        assert found.edge_score == found.explained == 1.0
        assert found.support > 0.98
        assert found.violation == 0.0
        assert found.measured == 1.0
        assert found.score > 0.9


def test_a_pose_that_floats_before_what_was_measured_is_rejected() -> None:
    found = verdict(lifted(LEANING, 0.02), boundary_at=lifted(LEANING, 0.02))  # even if its edges were there
    assert found.edge_score == found.explained == 1.0
    assert found.violation > 0.95
    assert found.support == 0.0
    assert found.score < 0.1


def test_a_pose_before_the_bare_floor_is_rejected() -> None:
    found = verdict(LEANING, FLOOR)
    assert found.violation == 1.0
    assert found.score < 0.1


def test_a_pose_behind_something_is_not_said_to_float() -> None:
    plate = trimesh.creation.box((0.04, 0.2, 0.002), make_transform(None, (-0.02, 0.0, 0.4)))
    found = verdict(LEANING, at.look_at(at.placed(ELL, LEANING), plate))
    assert found.violation == 0.0
    assert 0.2 < found.support < 0.8
    whole = trimesh.creation.box((0.3, 0.3, 0.002), make_transform(None, (0.0, 0.0, 0.4)))
    occluded = verdict(LEANING, at.look_at(at.placed(ELL, LEANING), whole))
    assert (occluded.violation, occluded.support, occluded.measured) == (0.0, 0.0, 1.0)
    assert found.visible_fraction == found.support
    assert verdict(LEANING).score >= found.score > occluded.score


def test_the_mirror_pose_of_a_flat_part_has_less_support() -> None:
    """Turned over about its long arm, the block's short arm lies on the wrong side, over bare floor."""
    frame = at.look_at(at.placed(ELL, FROM_ABOVE), noise=SIGMA)
    pivot = np.array([0.0, 0.01, at.HEIGHT / 2])
    turn = rotation_about((1.0, 0.0, 0.0), np.pi)
    mirrored = verdict(FROM_ABOVE @ make_transform(turn, pivot - turn @ pivot), frame, FROM_ABOVE)
    upright = verdict(FROM_ABOVE, frame, FROM_ABOVE)
    assert mirrored.support < upright.support - 0.2
    assert mirrored.violation > 0.2
    assert mirrored.edge_score < upright.edge_score
    assert mirrored.explained < upright.explained
    assert mirrored.score < upright.score


def test_a_pose_a_pixel_off_does_not_float_at_its_outline() -> None:
    frame = at.look_at(at.placed(ELL, FROM_ABOVE))
    pixel = at.DISTANCE / K[0, 0]
    aside = make_transform(None, (0.9 * pixel, 0.9 * pixel, 0.0)) @ FROM_ABOVE
    assert verdict(aside, frame, FROM_ABOVE).violation < 0.01
    assert verify(aside, MODEL, SURFACE, observed(frame, GROUP), replace(CONFIG, window=0)).violation > 0.02
    far = make_transform(None, (0.006, 0.0, 0.0)) @ FROM_ABOVE
    assert 0.1 < verdict(far, frame, FROM_ABOVE).violation < 0.5


def test_pixels_without_depth_count_neither_way() -> None:
    depth = SEEN.depth.copy()
    depth[:, : at.SIZE[0] // 2] = 0.0
    found = verdict(LEANING, at.framed(depth))
    assert 0.2 < found.measured < 0.8
    assert found.support > 0.98
    assert found.violation == 0.0
    assert found.visible_fraction == found.support * found.measured


@pytest.mark.parametrize("shift", [(1.0, 0.0, 0.0), (0.0, 0.0, -2.0)], ids=["out of view", "behind the camera"])
def test_a_pose_that_cannot_be_seen_has_nothing_for_it(shift: tuple[float, float, float]) -> None:
    found = verdict(make_transform(None, shift) @ LEANING)
    assert (found.edge_score, found.explained, found.support, found.violation, found.measured) == (0.0,) * 5
    assert found.score < 0.1


def test_the_edge_score_is_the_share_of_unoccluded_edges_with_points() -> None:
    keep = at.wires(ELL, 0.0005)[0][:, 0] < 0.02
    points, tangents = (a[keep] for a in GROUP)
    expected = np.mean(MODEL.points[:, 0] < 0.02)
    assert scores(LEANING, points, tangents)[0] == pytest.approx(expected, abs=0.05)  # over a floor nothing hides
    assert scores(LEANING, points, np.roll(tangents, 1, axis=1))[0] < 0.1
    assert scores(LEANING, points, np.roll(tangents, 1, axis=1), edge_angle=np.pi / 2)[0] > 0.9 * expected
    assert scores(LEANING, points, tangents, edge_distance=1e-6)[0] < 0.1
    assert scores(LEANING, points, tangents, edge_distance=0.3)[0] > expected + 0.2


def test_edges_that_something_hides_do_not_count() -> None:
    keep = at.wires(ELL, 0.0005)[0][:, 0] < 0.02
    points, tangents = (a[keep] for a in GROUP)
    over_a_floor = scores(LEANING, points, tangents)[0]
    own = scores(LEANING, points, tangents, at.look_at(at.placed(ELL, LEANING)))[0]
    assert over_a_floor + 0.02 < own < 0.95  # without those on the block's far side
    cover = at.look_at(trimesh.creation.box((0.3, 0.3, 0.002), make_transform(None, (0.0, 0.0, 0.4))))
    assert scores(LEANING, points, tangents, cover)[0] == 1.0
    far_aside = points + np.array([0.12, 0.0, 0.0])
    assert scores(LEANING, far_aside, tangents, cover)[0] == 0.0  # nothing is seen and nothing could be
    blind = at.framed(np.pad(np.full((1, 1), 0.5, np.float32), ((0, 179), (0, 239))))
    assert scores(LEANING, points, tangents, blind)[0] == 1.0
    deep = at.framed(np.full(SEEN.depth.shape, 0.45, np.float32))  # 1 to 10 cm before the block
    assert scores(LEANING, points, tangents, deep)[0] == 1.0
    assert scores(LEANING, points, tangents, deep, noise=0.05)[0] == over_a_floor
    assert scores(LEANING, points, tangents, deep, surface_distance=2.0)[0] == over_a_floor


def test_what_a_pose_leaves_of_its_group_is_not_explained() -> None:
    points, tangents = GROUP
    away = np.concatenate([points, points[::3] + np.array([0.0, 0.0, 0.02])]), np.concatenate([tangents, tangents[::3]])
    explained = verify(LEANING, MODEL, SURFACE, observed(SEEN, away)).explained
    assert explained == pytest.approx(0.75, abs=0.05)
    across = points, np.roll(tangents, 1, axis=1)
    assert verify(LEANING, MODEL, SURFACE, observed(SEEN, across)).explained < 0.1
    nothing = np.zeros((0, 3)), np.zeros((0, 3))
    assert verify(LEANING, MODEL, SURFACE, observed(SEEN, nothing)).explained == 0.0
    strict = replace(CONFIG, edge_distance=0.001)
    assert verify(LEANING, MODEL, SURFACE, observed(SEEN, GROUP), strict).explained < 0.3


def test_in_noisy_depth_an_edge_may_lie_deeper_but_not_elsewhere_in_the_image() -> None:
    points, tangents = GROUP
    deeper = points * (1 + 0.006 / np.linalg.norm(points, axis=1, keepdims=True))  # 6 mm along the line of sight
    aside = points + np.array([0.006, 0.0, 0.0])
    clean = scores(LEANING, points, tangents)
    for quiet in (scores(LEANING, deeper, tangents), scores(LEANING, deeper, tangents, noise=0.001)):
        assert quiet[0] < 0.9 * clean[0]  # some edges meet others
        assert quiet[1] < 0.9 * clean[1]
    assert scores(LEANING, deeper, tangents, noise=0.002)[0] > 0.97 * clean[0]
    assert scores(LEANING, deeper, tangents, noise=0.002)[1] == clean[1] == 1.0
    assert scores(LEANING, aside, tangents, noise=0.002)[1] < 0.9


def test_only_edges_of_the_view_count() -> None:
    """A second copy of the edges, 5 mm aside, belongs to the view from behind."""
    direction = -(LEANING[:3, :3] @ ELL.centre + LEANING[:3, 3]) @ LEANING[:3, :3]
    model = replace(
        at.all_visible(np.concatenate([MODEL.points, MODEL.points + 0.005]), np.tile(MODEL.tangents, (2, 1)), ELL),
        visibility=np.repeat([1, 2], len(MODEL)).astype(np.uint32),
        views=np.stack([direction, -direction]) / np.linalg.norm(direction),
    )
    assert edge_scores(LEANING, model, observed(FLOOR, GROUP), CONFIG) == (1.0, 1.0)
    other = replace(model, views=-model.views)
    assert max(edge_scores(LEANING, other, observed(FLOOR, GROUP), CONFIG)) < 0.5
    unseen = replace(MODEL, visibility=np.zeros(len(MODEL), np.uint32))
    assert edge_scores(LEANING, unseen, observed(FLOOR, GROUP), CONFIG) == (0.0, 0.0)


def test_tolerance_covers_the_sensor_s_noise() -> None:
    rough = at.look_at(at.placed(ELL, LEANING), noise=0.002)
    strict = verify(LEANING, MODEL, SURFACE, observed(rough, GROUP), replace(CONFIG, window=0))
    fair = verify(LEANING, MODEL, SURFACE, observed(rough, GROUP), replace(CONFIG, window=0, noise=0.002))
    loose = verify(LEANING, MODEL, SURFACE, observed(rough, GROUP), replace(CONFIG, window=0, surface_distance=0.1))
    assert strict.support < 0.85
    assert strict.violation > 0.05
    assert min(fair.support, loose.support) > 0.97
    assert verify(LEANING, MODEL, SURFACE, observed(rough, GROUP), CONFIG).support > strict.support


def test_the_logit_is_the_weighted_sum_of_four_shares() -> None:
    config = VerificationConfig(
        bias=-1.0, edge_weight=2.0, explained_weight=3.0, support_weight=-4.0, violation_weight=8.0
    )
    assert ranking_logit(0.5, 0.25, 0.125, 0.0625, config) == -1.0 + 1.0 + 0.75 - 0.5 + 0.5
    found = verify(LEANING, MODEL, SURFACE, observed(FLOOR, GROUP), config)
    shares = found.edge_score, found.explained, found.support, found.violation
    assert found.logit == ranking_logit(*shares, config)


def test_the_score_is_the_logistic_of_the_logit() -> None:
    found = verdict(LEANING)
    for weighted in (-30.0, -1.0, 0.0, 0.25):
        assert replace(found, logit=weighted).score == pytest.approx(1 / (1 + np.exp(-weighted)), rel=1e-3)
    for extreme in (-5000.0, 5000.0):
        assert replace(found, logit=extreme).score == (extreme > 0)


# Kernels


@pytest.mark.slow
@pytest.mark.parametrize("distance", [0.0, 0.3, -0.42, -0.6])
def test_visible_samples_are_those_of_the_twin(distance: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(3):
        T = make_transform(None, (0.0, 0.0, distance)) @ at.random_pose(ELL, rng)
        found = surface_kernels.visible_samples(T, SURFACE.points, SURFACE.normals, 0.2, SURFACE.spacing)
        want = twin.visible_samples(T, SURFACE.points, SURFACE.normals, 0.2, SURFACE.spacing)
        assert found.tolist() == want.tolist()
        assert found.any() == (distance > -0.6)


def test_one_box_hides_another() -> None:
    boxes = [trimesh.creation.box((0.03, 0.03, 0.01), make_transform(None, (0.0, 0.0, z))) for z in (0.0, 0.05)]
    part = PartModel.from_mesh("two", trimesh.util.concatenate(boxes))
    surface = surface_model(part)
    visible = surface.visible(make_transform(OVER, (0.0, 0.0, 0.5)))
    up = surface.normals[:, 2] > 0.9
    assert visible[up & (surface.points[:, 2] > 0.05)].mean() > 0.98
    assert visible[up & (surface.points[:, 2] < 0.01)].mean() < 0.1
    assert not visible[~up].any()


def test_a_convex_part_hides_what_is_turned_away_and_nothing_else() -> None:
    box = surface_model(PartModel.from_mesh("box", trimesh.creation.box((0.05, 0.04, 0.03))))
    rng = np.random.default_rng(0)
    for _ in range(5):
        T = at.random_pose(ELL, rng)
        points, normals = twin.posed(T, box.points, box.normals)
        cosine = -(normals * points).sum(axis=1) / np.linalg.norm(points, axis=1)
        np.testing.assert_array_equal(box.visible(T), cosine >= 0.2)


@pytest.mark.parametrize("radius", [0, 1])
def test_surface_gaps_are_those_of_the_twin(radius: int) -> None:
    depth = SEEN.depth.copy()
    depth[::5] = 0.0
    start = at.beside(LEANING, ELL, np.random.default_rng(0), 0.004, 0.1)
    for aside in (0.0, 0.05):
        T = make_transform(None, (aside, 0.0, 0.0)) @ start
        visible = SURFACE.visible(T)
        found = kernels.surface_gaps(T, SURFACE.points, SURFACE.normals, visible, depth, K, radius)
        want = twin.surface_gaps(T, SURFACE.points, SURFACE.normals, visible, depth, K, radius)
        np.testing.assert_allclose(found, want, rtol=1e-7, atol=1e-9)
        assert np.isnan(found).any()
        assert not np.isnan(found).all()


def test_a_sample_that_is_not_before_the_camera_has_no_gap() -> None:
    """Called visible, it would be projected through a depth of 0 or from behind the camera."""
    points = np.array([[0.01, 0.02, z] for z in (0.0, 0.001, -0.4, 0.4)])
    normals = np.tile([0.0, 0.0, -1.0], (4, 1))
    arguments = np.eye(4), points, normals, np.ones(4, bool), FLOOR.depth, K, 1
    found = kernels.surface_gaps(*arguments)
    np.testing.assert_allclose(found, [np.nan, np.nan, np.nan, at.FLOOR - 0.4], rtol=1e-6)
    np.testing.assert_allclose(found, twin.surface_gaps(*arguments), rtol=1e-7)


@pytest.mark.parametrize("tolerance", [0.0005, 0.004])
def test_gaps_are_counted_as_they_are(tolerance: float) -> None:
    depth = SEEN.depth.copy()
    depth[85:95] = 0.0
    T = at.beside(LEANING, ELL, np.random.default_rng(0), 0.004, 0.1)
    arguments = T, SURFACE.points, SURFACE.normals, SURFACE.visible(T), depth, K, 1
    gaps = kernels.surface_gaps(*arguments)
    known = gaps[~np.isnan(gaps)]
    want = (
        np.count_nonzero(arguments[3]),
        len(known),
        *((np.abs(known) <= tolerance).sum(), (known > tolerance).sum()),
    )
    assert verification_kernels.gap_counts(*arguments, tolerance) == want
    assert 0 < want[3] < want[2] + want[3] < want[1] < want[0], want


def test_a_gap_is_positive_where_the_camera_saw_through() -> None:
    visible = SURFACE.visible(FROM_ABOVE)
    for height, sign in ((0.01, 1.0), (-0.01, -1.0)):
        frame = at.look_at(at.placed(ELL, FROM_ABOVE))
        T = lifted(FROM_ABOVE, height)
        gaps = kernels.surface_gaps(T, SURFACE.points, SURFACE.normals, visible, frame.depth, frame.K, 0)
        assert np.nanmedian(gaps) == pytest.approx(sign * 0.01, abs=1e-6)


# Bad input


def test_a_bad_pose_and_an_empty_frame_are_refused() -> None:
    with pytest.raises(ValueError, match="T_cam_part must be finite"):
        verify(LEANING * np.nan, MODEL, SURFACE, observed(SEEN, GROUP))
    with pytest.raises(ValueError, match=r"T_cam_part must be \(4, 4\)"):
        edge_scores(LEANING[:3], MODEL, observed(SEEN, GROUP), CONFIG)
    with pytest.raises(ValueError, match="the frame must have a depth somewhere"):
        verify(LEANING, MODEL, SURFACE, observed(at.framed(np.zeros((60, 80), np.float32)), GROUP))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"edge_distance": 0.0}, "edge_distance must be positive, got 0.0"),
        ({"surface_distance": np.nan}, "surface_distance must be positive, got nan"),
        ({"edge_angle": 20.0}, r"edge_angle must be in \(0, pi/2\] rad, got 20.0"),
        ({"noise": -0.1}, "noise must not be negative, got -0.1"),
        ({"window": -1}, "window must not be negative, got -1"),
        *[({f.name: np.nan}, f"{f.name} must be finite, got nan") for f in fields(CONFIG)[-5:]],
    ],
)
def test_nonsense_in_the_config_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(CONFIG, **change)
