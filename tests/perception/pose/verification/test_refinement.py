"""Recovery of poses from wires and from depth images."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from perception.geometry import Floats, make_transform, rotation_about
from perception.metrics.pose_errors import pose_error
from perception.part import PartModel, Symmetry
from perception.pose.model.edge_models import EdgeModel
from perception.pose.model.surface_models import surface_model
from perception.pose.verification.boundary_index import index_boundary
from perception.pose.verification.refinement import (
    EdgeRefinement,
    RefinedPose,
    SurfaceRefinement,
    refine_edges,
    refine_surface,
    view_direction,
)
from tests.perception.pose import observed_part as at
from tests.perception.pose.observed_part import DISTANCE, SIGMA

Z = np.array([0.0, 0.0, 1.0])
ELL = at.ell()
MODEL = at.wire_model(ELL)
SURFACE = surface_model(ELL)
OVER = rotation_about((1.0, 0.0, 0.0), np.pi)
FROM_ABOVE = at.pose_of(ELL, OVER)  # its top square to the view
LEANING = at.pose_of(ELL, rotation_about((1.0, 1.0, 0.0), 0.7) @ OVER)  # its top and two sides in view
OFF = np.radians(5.0)


def assert_at(pose: RefinedPose, T: Floats, shift: float, degrees: float, part: PartModel = ELL) -> None:
    error = pose_error(pose.T_cam_part, T, part)
    assert pose.converged
    assert error.translation < shift
    assert np.degrees(error.rotation) < degrees


def ring(radius: float, height: float, count: int) -> tuple[Floats, Floats]:
    """Return points on a circle about z and their tangents."""
    angle = 2 * np.pi * np.arange(count) / count
    cosine, sine = np.cos(angle), np.sin(angle)
    points = np.column_stack([radius * cosine, radius * sine, np.full(count, height)])
    return points, np.column_stack([-sine, cosine, np.zeros(count)])


# Point to line


@pytest.mark.parametrize("seed", range(6))
def test_edges_recover_a_pose_5_mm_and_5_degrees_off(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = at.random_pose(ELL, rng)
    boundary = at.wire_index(T, ELL, rng)
    wide = EdgeRefinement(gates=(0.12, 0.05, 0.02, 0.01))  # the part is small: 5 mm are a fifteenth of it
    pose = refine_edges(at.beside(T, ELL, rng, 0.005, OFF), MODEL, boundary, wide)
    assert_at(pose, T, 1e-5, 0.02)
    assert pose.error < 1e-5
    assert pose.inliers == len(MODEL)
    assert_at(refine_edges(at.beside(T, ELL, rng, 0.003, OFF), MODEL, boundary), T, 1e-5, 0.02)


@pytest.mark.parametrize("seed", range(4))
def test_edges_recover_a_pose_from_noisy_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = at.random_pose(ELL, rng)
    boundary = index_boundary(*at.wire_scene(T, ELL, rng, noise=SIGMA), ELL.d_max)
    pose = refine_edges(at.beside(T, ELL, rng, 0.003, OFF), MODEL, boundary)
    assert_at(pose, T, 0.0002, 0.4)
    assert 1e-5 < pose.error < 2 * SIGMA


@pytest.mark.parametrize("seed", range(4))
def test_edges_recover_a_pose_of_which_half_is_occluded(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = at.random_pose(ELL, rng)
    keep = at.wires(ELL, 0.0005)[0][:, 0] < 0.0205
    assert 0.4 < keep.mean() < 0.6
    boundary = index_boundary(*at.wire_scene(T, ELL, rng, noise=SIGMA, keep=keep), ELL.d_max)
    assert_at(refine_edges(at.beside(T, ELL, rng, 0.002, OFF / 2), MODEL, boundary), T, 0.0006, 1.0)


@pytest.mark.parametrize("seed", range(4))
def test_edges_recover_a_pose_among_lines_of_other_parts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = at.random_pose(ELL, rng)
    points, tangents = at.wire_scene(T, ELL, rng, noise=SIGMA)
    for _ in range(12):  # lines through the part's neighbourhood in all directions
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        through = T[:3, :3] @ ELL.centre + T[:3, 3] + 0.02 * rng.normal(size=3)
        line = through + np.outer(np.arange(-60, 60), direction / 1000)
        points, tangents = np.vstack([points, line]), np.vstack([tangents, np.tile(direction, (len(line), 1))])
    boundary = index_boundary(points, tangents, ELL.d_max)
    assert_at(refine_edges(at.beside(T, ELL, rng, 0.003, OFF), MODEL, boundary), T, 0.0004, 0.6)


def test_a_pose_slides_neither_along_nor_about_a_straight_edge() -> None:
    x = np.linspace(-0.02, 0.02, 41)
    along = np.tile([1.0, 0.0, 0.0], (len(x), 1))
    model = replace(at.all_visible(np.column_stack([x, 0 * x, 0 * x]), along, ELL), centre=np.zeros(3))
    x = np.arange(-0.1, 0.1, 0.0004)
    rng = np.random.default_rng(0)
    scene = np.column_stack([x, 0 * x, 0 * x + DISTANCE]) + SIGMA * rng.normal(size=(len(x), 3))
    measured = np.array([1.0, 0.0, 0.0]) + 0.04 * rng.normal(size=scene.shape)  # whose noise seems to tell of a slide
    boundary = index_boundary(scene, measured / np.linalg.norm(measured, axis=1, keepdims=True), ELL.d_max)
    start = make_transform(rotation_about((1.0, 0.0, 0.0), 0.3), (0.007, 0.002, DISTANCE + 0.001))
    pose = refine_edges(start, model, boundary)
    assert pose.converged
    np.testing.assert_allclose(pose.T_cam_part[:3, 3], [0.007, 0.0, DISTANCE], atol=0.0002)
    np.testing.assert_allclose(pose.T_cam_part[:3, :3], start[:3, :3], atol=0.01)
    naive = refine_edges(start, model, boundary, EdgeRefinement(observable=0.0, damping=0.0)).T_cam_part
    assert abs(naive[0, 3] - 0.007) > 2 * abs(pose.T_cam_part[0, 3] - 0.007)


def test_a_solid_of_revolution_is_found_without_spinning() -> None:
    part = PartModel.from_mesh("disc", trimesh.creation.cylinder(0.03, 0.01, sections=48), Symmetry(axis=Z))
    rims = [np.concatenate(halves) for halves in zip(ring(0.03, 0.005, 90), ring(0.02, -0.005, 60), strict=True)]
    model = at.all_visible(rims[0], rims[1], part)
    T = at.pose_of(part, rotation_about((1.0, 0.5, 0.0), 2.5))
    fine = [np.concatenate(halves) for halves in zip(ring(0.03, 0.005, 600), ring(0.02, -0.005, 400), strict=True)]
    boundary = index_boundary(fine[0] @ T[:3, :3].T + T[:3, 3], fine[1] @ T[:3, :3].T, part.d_max)
    tilt = rotation_about((1.0, 0.0, 0.0), OFF / 2) @ T[:3, :3] @ rotation_about(Z, 0.7)
    start = make_transform(tilt, T[:3, 3] + [0.001, -0.001, 0.001])
    pose = refine_edges(start, model, boundary)
    assert_at(pose, T, 1e-5, 0.05, part)
    spin = T[:3, :3].T @ pose.T_cam_part[:3, :3]
    # The rims were 1.7 mm off: half a millimetre of their 30 mm radius is no more than the way there turns them.
    assert np.arctan2(spin[1, 0], spin[0, 0]) == pytest.approx(0.7, abs=0.015)


def test_a_pose_far_away_stays_and_has_not_converged() -> None:
    rng = np.random.default_rng(0)
    boundary = at.wire_index(LEANING, ELL, rng)
    far = make_transform(None, (0.15, 0.0, 0.0)) @ LEANING
    pose = refine_edges(far, MODEL, boundary)
    assert (pose.converged, pose.inliers, pose.iterations, pose.error) == (False, 0, 0, np.inf)
    assert pose.T_cam_part.tobytes() == far.tobytes()
    behind = make_transform(None, (0.0, 0.0, -2.0)) @ LEANING
    assert not refine_edges(behind, MODEL, boundary).converged
    inside = make_transform(None, -LEANING[:3, :3] @ ELL.centre - LEANING[:3, 3]) @ LEANING
    assert not refine_edges(inside, MODEL, boundary).converged


def test_too_few_matches_are_not_converged() -> None:
    rng = np.random.default_rng(0)
    keep = at.wires(ELL, 0.0005)[0][:, 0] < 0.002
    boundary = index_boundary(*at.wire_scene(LEANING, ELL, rng, keep=keep), ELL.d_max)
    pose = refine_edges(LEANING, MODEL, boundary)
    share = pose.inliers / len(MODEL)
    assert 0.1 < share < 0.4
    assert pose.converged
    assert not refine_edges(LEANING, MODEL, boundary, EdgeRefinement(min_matched=0.5)).converged


def test_a_pose_that_still_moves_has_not_converged() -> None:
    boundary = at.wire_index(LEANING, ELL, np.random.default_rng(0))
    start = at.beside(LEANING, ELL, np.random.default_rng(2), 0.003, OFF)
    hasty = refine_edges(start, MODEL, boundary, EdgeRefinement(gates=(0.05,), iterations=1))
    assert (hasty.converged, hasty.iterations) == (False, 1)
    assert hasty.inliers > len(MODEL) / 2


def test_no_gate_is_finer_than_the_sensor() -> None:
    boundary = at.wire_index(LEANING, ELL, np.random.default_rng(0))
    start = at.beside(LEANING, ELL, np.random.default_rng(2), 0.0004, 0.0)
    assert_at(refine_edges(start, MODEL, boundary, EdgeRefinement(gates=(1e-6,))), LEANING, 1e-5, 0.02)
    assert refine_edges(start, MODEL, boundary, EdgeRefinement(gates=(1e-6,), finest=0.0)).inliers < 6


def test_the_signs_of_tangents_change_nothing() -> None:
    points, tangents = at.wire_scene(LEANING, ELL, np.random.default_rng(1), noise=SIGMA)
    start = at.beside(LEANING, ELL, np.random.default_rng(2), 0.003, OFF)
    poses = [refine_edges(start, MODEL, index_boundary(points, s * tangents, ELL.d_max)) for s in (1.0, -1.0)]
    assert poses[0].T_cam_part.tobytes() == poses[1].T_cam_part.tobytes()


def test_the_order_of_the_points_changes_nothing() -> None:
    points, tangents = at.wire_scene(LEANING, ELL, np.random.default_rng(1), noise=SIGMA)
    start = at.beside(LEANING, ELL, np.random.default_rng(2), 0.003, OFF)
    poses = [refine_edges(start, MODEL, index_boundary(points[::s], tangents[::s], ELL.d_max)) for s in (1, -1)]
    np.testing.assert_allclose(poses[0].T_cam_part, poses[1].T_cam_part, atol=1e-9)


def test_only_edges_of_the_view_are_matched() -> None:
    """A second copy of the edges, seen from the other side only and 2 mm aside, must not pull."""
    points = np.concatenate([MODEL.points, MODEL.points + 0.002])
    direction = view_direction(LEANING, ELL.centre)
    model = EdgeModel(
        points=points,
        tangents=np.tile(MODEL.tangents, (2, 1)),
        visibility=np.repeat([1, 2], len(MODEL)).astype(np.uint32),
        views=np.stack([direction, -direction]),
        centre=ELL.centre,
        d_max=ELL.d_max,
    )
    boundary = at.wire_index(LEANING, ELL, np.random.default_rng(0))
    assert_at(refine_edges(LEANING, model, boundary), LEANING, 1e-5, 0.02)
    turned = replace(model, views=-model.views)
    assert pose_error(refine_edges(LEANING, turned, boundary).T_cam_part, LEANING, ELL).translation > 0.001


def test_the_view_direction_points_from_the_part_to_the_camera() -> None:
    np.testing.assert_allclose(view_direction(FROM_ABOVE, ELL.centre), [0.0, 0.0, 1.0], atol=1e-12)
    assert view_direction(make_transform(), np.zeros(3)).tolist() == [0.0, 0.0, 1.0]


# Point to plane


@pytest.mark.parametrize("noise", [0.0, SIGMA])
def test_the_surface_recovers_a_pose(noise: float) -> None:
    frame = at.look_at(at.placed(ELL, LEANING), noise=noise)
    for seed in range(3):
        start = at.beside(LEANING, ELL, np.random.default_rng(seed), 0.0008, np.radians(1.0))
        pose = refine_surface(start, SURFACE, frame, SurfaceRefinement(iterations=15))
        assert_at(pose, LEANING, 0.0003, 0.3)
        assert pose.error < 2e-4 + 1.2 * noise


@pytest.mark.parametrize(("noise", "tilt"), [(0.0, 1e-5), (SIGMA, 0.01)])
def test_the_surface_does_not_slide_a_face_in_its_plane(noise: float, tilt: float) -> None:
    frame = at.look_at(at.placed(ELL, FROM_ABOVE), noise=noise)
    start = make_transform(rotation_about((1.0, 0.0, 0.0), 0.03)) @ FROM_ABOVE
    start[:3, 3] = FROM_ABOVE[:3, 3] + [0.002, -0.001, 0.0005]
    pose = refine_surface(start, SURFACE, frame)
    assert pose.converged
    middle = ELL.centre * [1.0, 1.0, 0.0] + [0.0, 0.0, at.HEIGHT]  # of the top
    found, began, true = (T[:3, :3] @ middle + T[:3, 3] for T in (pose.T_cam_part, start, FROM_ABOVE))
    np.testing.assert_allclose(found[:2], began[:2], atol=0.0003)
    assert found[2] == pytest.approx(true[2], abs=1e-6 + noise / 3)
    assert np.arccos(-(pose.T_cam_part[:3, :3] @ Z)[2]) < tilt


def test_a_surface_that_was_not_measured_is_not_converged() -> None:
    frame = at.look_at()
    floating = refine_surface(FROM_ABOVE, SURFACE, frame)
    assert (floating.converged, floating.inliers, floating.error) == (False, 0, np.inf)
    for aside in ((1.0, 0.0, 0.0), (0.0, 0.0, -2.0)):
        assert not refine_surface(make_transform(None, aside) @ FROM_ABOVE, SURFACE, frame).converged


def test_a_share_of_the_surface_must_match() -> None:
    occluded = at.look_at(at.placed(ELL, FROM_ABOVE)).depth.copy()
    occluded[:, : at.SIZE[0] // 2] = 0.3
    assert refine_surface(FROM_ABOVE, SURFACE, at.framed(occluded)).converged
    strict = SurfaceRefinement(min_matched=0.9)
    assert not refine_surface(FROM_ABOVE, SURFACE, at.framed(occluded), strict).converged


def test_a_wide_gate_comes_before_a_fine_one() -> None:
    frame = at.look_at(at.placed(ELL, LEANING), noise=SIGMA)
    start = make_transform(None, 0.0035 * LEANING[:3, 3] / np.linalg.norm(LEANING[:3, 3])) @ LEANING
    fine, wide, both = ((0.02,), (0.06,), (0.06, 0.02))
    found = {
        gates: refine_surface(start, SURFACE, frame, SurfaceRefinement(gates=gates)) for gates in (fine, wide, both)
    }
    away = {g: pose_error(found[g].T_cam_part, LEANING, ELL).translation for g in found}
    assert away[fine] > 0.003  # nothing within the gate
    assert max(away[wide], away[both]) < 0.0007
    assert found[both].iterations > found[wide].iterations
    assert found[both].converged
    ungated = SurfaceRefinement(gates=(1e-6,))  # no finer than the sensor
    near = make_transform(None, (0.0, 0.0, 0.0003)) @ LEANING
    assert refine_surface(near, SURFACE, frame, ungated).inliers > 100
    assert refine_surface(near, SURFACE, frame, replace(ungated, finest=0.0)).inliers < 6


def test_the_view_of_each_stage_is_that_of_its_start() -> None:
    """A pose that comes round to another view goes on with that one's edges."""
    direction = view_direction(LEANING, ELL.centre)
    asked = []

    class Seen:
        centre, d_max = ELL.centre, ELL.d_max

        def seen_from(self, direction_part: Floats) -> tuple[Floats, Floats]:
            asked.append(direction_part)
            return MODEL.points, MODEL.tangents

    boundary = at.wire_index(LEANING, ELL, np.random.default_rng(0))
    start = at.beside(LEANING, ELL, np.random.default_rng(2), 0.003, OFF)
    assert_at(refine_edges(start, Seen(), boundary), LEANING, 1e-5, 0.02)
    assert len(asked) == len(EdgeRefinement().gates)
    np.testing.assert_allclose(asked[0], view_direction(start, ELL.centre), atol=1e-12)
    assert np.linalg.norm(asked[-1] - direction) < 0.002 < np.linalg.norm(asked[0] - direction)


# Bad input


def test_a_bad_pose_is_refused() -> None:
    boundary = at.wire_index(LEANING, ELL, np.random.default_rng(0))
    frame = at.look_at()
    for refine in (lambda T: refine_edges(T, MODEL, boundary), lambda T: refine_surface(T, SURFACE, frame)):
        with pytest.raises(ValueError, match="T_cam_part must be finite"):
            refine(LEANING * np.nan)
        with pytest.raises(ValueError, match=r"T_cam_part must be \(4, 4\), got \(3, 4\)"):
            refine(LEANING[:3])


def test_a_frame_without_depth_is_refused() -> None:
    empty = at.framed(np.zeros((60, 80), np.float32))
    with pytest.raises(ValueError, match="the frame must have a depth somewhere"):
        refine_surface(LEANING, SURFACE, empty)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gates": ()}, "gates must be positive and at least one"),
        ({"gates": (0.05, 0.0)}, "gates must be positive and at least one"),
        ({"finest": -1.0}, "finest must not be negative, got -1.0"),
        ({"iterations": 0}, "iterations must be at least 1, got 0"),
        ({"max_angle": 25.0}, r"max_angle must be in \(0, pi/2\] rad, got 25.0"),
        ({"damping": -1.0}, "damping must not be negative, got -1.0"),
        ({"observable": np.nan}, "observable must not be negative, got nan"),
        ({"still": np.inf}, "still must not be negative, got inf"),
        ({"min_matched": 1.1}, r"min_matched must be in \[0, 1\], got 1.1"),
    ],
)
def test_nonsense_in_the_edge_config_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(EdgeRefinement(), **change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gates": ()}, "gates must be positive and at least one"),
        ({"gates": (0.06, np.inf)}, "gates must be positive and at least one"),
        ({"finest": -1.0}, "finest must not be negative, got -1.0"),
        ({"iterations": 0}, "iterations must be at least 1, got 0"),
        ({"max_angle": 0.0}, r"max_angle must be in \(0, pi/2\] rad, got 0.0"),
        ({"damping": np.nan}, "damping must not be negative, got nan"),
        ({"observable": -0.1}, "observable must not be negative, got -0.1"),
        ({"still": -1e-5}, "still must not be negative, got -1e-05"),
        ({"reach": 0}, "reach must be at least 1 px, got 0"),
        ({"min_matched": -0.1}, r"min_matched must be in \[0, 1\], got -0.1"),
    ],
)
def test_nonsense_in_the_surface_config_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(SurfaceRefinement(), **change)
