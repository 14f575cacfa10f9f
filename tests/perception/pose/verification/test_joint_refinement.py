"""Recovery of poses from edges in the image and a depth image at once."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from perception.geometry import Floats, invert_transform, make_transform, rotation_about
from perception.metrics.pose_errors import pose_error
from perception.part import PartModel
from perception.pose.model.surface_models import surface_model
from perception.pose.verification.boundary_index import index_boundary
from perception.pose.verification.joint_refinement import JointRefinement, refine_jointly
from perception.pose.verification.refinement import refine_edges, refine_surface
from perception.pose.verification.verification import ObservedGroup
from tests.perception.pose import observed_part as at

ELL = at.ell()
MODEL = at.wire_model(ELL)
SURFACE = surface_model(ELL)
OVER = rotation_about((1.0, 0.0, 0.0), np.pi)
LEANING = at.pose_of(ELL, rotation_about((1.0, 1.0, 0.0), 0.7) @ OVER)
FROM_ABOVE = at.pose_of(ELL, OVER)


def seen(T: Floats, rng: np.random.Generator, noise: float = 0.0, along_ray: float = 0.0) -> ObservedGroup:
    """Return what is seen of the part: its wires, whose depth alone may err [m], and a depth image with noise."""
    points, tangents = at.wire_scene(T, ELL, rng)
    points = points * (1 + along_ray * rng.normal(size=(len(points), 1)) / at.DISTANCE)
    frame = at.look_at(at.placed(ELL, T), noise=noise)
    boundary = index_boundary(points, tangents, ELL.d_max)
    return ObservedGroup(points_cam=points, tangents_cam=tangents, boundary=boundary, frame=frame)


def off(T: Floats, group: ObservedGroup, seed: int, config: JointRefinement | None = None) -> tuple[float, float]:
    """Return the errors [mm, deg] that are left from a start 1 mm and 2 degrees off."""
    start = at.beside(T, ELL, np.random.default_rng(seed), 0.001, np.radians(2.0))
    found = refine_jointly(start, MODEL, SURFACE, group, config)
    assert found.converged
    error = pose_error(found.T_cam_part, T, ELL)
    return 1e3 * error.translation, float(np.degrees(error.rotation))


@pytest.mark.parametrize("T", [LEANING, FROM_ABOVE], ids=["leaning", "from_above"])
def test_a_pose_is_recovered_from_clean_data(T: Floats) -> None:
    group = seen(T, np.random.default_rng(0))
    for seed in range(3):
        millimetres, degrees = off(T, group, seed)
        assert millimetres < 0.15
        assert degrees < 0.3


def test_edges_in_the_image_hold_where_the_depth_is_noisy() -> None:
    """The depth of outlines and of the surface errs by 4 mm; their place in the image does not."""
    joint, separate = [], []
    for seed in range(6):
        group = seen(FROM_ABOVE, np.random.default_rng(seed), noise=0.004, along_ray=0.004)
        joint.append(off(FROM_ABOVE, group, seed, JointRefinement(depth_noise=0.004))[0])
        start = at.beside(FROM_ABOVE, ELL, np.random.default_rng(seed), 0.001, np.radians(2.0))
        edges = refine_edges(start, MODEL, group.boundary)
        last = refine_surface(edges.T_cam_part, SURFACE, group.frame)
        separate.append(1e3 * pose_error(last.T_cam_part, FROM_ABOVE, ELL).translation)
    assert np.median(joint) < 0.5
    assert np.median(joint) < 0.7 * np.median(separate)


def test_the_depth_of_a_boundary_point_has_no_influence() -> None:
    """Outlines that carry the depth of a surface 2 mm behind do not pull the part there."""
    rng = np.random.default_rng(1)
    group = seen(LEANING, rng)
    behind = group.points_cam * (1 + 0.002 / at.DISTANCE)
    shifted = replace(group, boundary=index_boundary(behind, group.tangents_cam, ELL.d_max))
    np.testing.assert_allclose(off(LEANING, shifted, 0), off(LEANING, group, 0), atol=0.05)
    start = at.beside(LEANING, ELL, np.random.default_rng(0), 0.001, np.radians(2.0))
    dragged = refine_edges(start, MODEL, shifted.boundary)
    assert pose_error(dragged.T_cam_part, LEANING, ELL).translation > 0.0015


def test_the_surface_alone_and_the_edges_alone_are_enough_where_they_determine_the_pose() -> None:
    group = seen(LEANING, np.random.default_rng(2))
    nothing = index_boundary(np.array([[0.0, 0.0, 9.0]]), np.array([[1.0, 0.0, 0.0]]), ELL.d_max)
    assert off(LEANING, replace(group, boundary=nothing), 0)[0] < 0.4
    far = at.framed(np.full_like(group.frame.depth, 2.0))
    assert off(LEANING, replace(group, frame=far), 0)[0] < 0.6


def test_the_origin_of_a_parts_drawing_has_no_influence() -> None:
    """The origin of this drawing is 2 m from the part; the weights of edges and depth are those at the part."""
    away = make_transform(None, (0.0, 0.0, -2.0))
    part = PartModel.from_mesh("far", ELL.mesh.copy().apply_transform(away))
    model, surface = at.wire_model(part), surface_model(part)
    group = seen(FROM_ABOVE, np.random.default_rng(6), noise=0.002)
    shifted = group.points_cam + np.array([0.0005, 0.0, 0.0])  # edges and depth disagree
    group = replace(group, boundary=index_boundary(shifted, group.tangents_cam, ELL.d_max))
    config = JointRefinement(depth_noise=0.002)
    near = refine_jointly(FROM_ABOVE, MODEL, SURFACE, group, config)
    far = refine_jointly(FROM_ABOVE @ invert_transform(away), model, surface, group, config)
    assert far.converged
    np.testing.assert_allclose(far.T_cam_part @ away, near.T_cam_part, atol=2e-5)


def test_a_pose_with_nothing_near_is_not_converged() -> None:
    group = seen(LEANING, np.random.default_rng(3))
    for aside in ((1.0, 0.0, 0.0), (0.0, 0.0, -2.0)):
        assert not refine_jointly(make_transform(None, aside) @ LEANING, MODEL, SURFACE, group).converged
    strict = JointRefinement(min_matched=1.0)
    assert not refine_jointly(LEANING, MODEL, SURFACE, group, strict).converged


def test_gates_follow_the_noise() -> None:
    group = seen(LEANING, np.random.default_rng(4), noise=0.003)
    told = refine_jointly(LEANING, MODEL, SURFACE, group, JointRefinement(depth_noise=0.003))
    untold = refine_jointly(LEANING, MODEL, SURFACE, group)
    assert told.inliers > 1.1 * untold.inliers


def test_bad_poses_and_frames_are_refused() -> None:
    group = seen(LEANING, np.random.default_rng(5))
    with pytest.raises(ValueError, match="T_cam_part must be finite"):
        refine_jointly(np.full((4, 4), np.nan), MODEL, SURFACE, group)
    empty = at.framed(np.zeros_like(group.frame.depth))
    with pytest.raises(ValueError, match="the frame must have a depth somewhere"):
        refine_jointly(LEANING, MODEL, SURFACE, replace(group, frame=empty))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"edge_gates": ()}, "edge_gates must be positive and at least one"),
        ({"edge_gates": (0.1, -1.0)}, "edge_gates must be positive and at least one"),
        ({"match_gate": 0.0}, "match_gate must be positive, got 0"),
        ({"surface_gate": np.inf}, "surface_gate must be positive, got inf"),
        ({"edge_noise": -1.0}, "edge_noise must be positive, got -1"),
        ({"depth_noise": 0.0}, "depth_noise must be positive, got 0"),
        ({"iterations": 0}, "iterations must be at least 1, got 0"),
        ({"max_angle": 2.0}, r"max_angle must be in \(0, pi/2\] rad, got 2"),
        ({"averaged": 0.0}, r"averaged must be in \(0, 1\], got 0"),
        ({"patch": -1}, "patch must not be negative, got -1"),
        ({"min_matched": 1.5}, r"min_matched must be in \[0, 1\], got 1.5"),
    ],
)
def test_nonsense_settings_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(JointRefinement(), **change)
