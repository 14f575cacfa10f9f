"""The error to expect of a pose: against the errors of refinements, and where symmetry or the data leave it open."""

from dataclasses import replace

import numpy as np
import pytest

from perception.geometry import Floats, rotation_about, transform_points
from perception.metrics.pose_errors import pose_error
from perception.part import Symmetry
from perception.pose.model.surface_models import surface_model
from perception.pose.verification.boundary_index import index_boundary
from perception.pose.verification.expected_error import CORRELATED, ExpectedError, expected_error
from perception.pose.verification.joint_refinement import JointRefinement, refine_jointly
from perception.pose.verification.verification import ObservedGroup
from tests.perception.pose import observed_part as at

ELL = at.ell()
MODEL, SURFACE = at.wire_model(ELL), surface_model(ELL)
OVER = rotation_about((1.0, 0.0, 0.0), np.pi)
LEANING = at.pose_of(ELL, rotation_about((1.0, 1.0, 0.0), 0.7) @ OVER)
NOISE = 0.002


def seen(T: Floats, rng: np.random.Generator, noise: float = NOISE) -> ObservedGroup:
    points, tangents = at.wire_scene(T, ELL, rng)
    frame = at.look_at(at.placed(ELL, T), noise=noise)
    boundary = index_boundary(points, tangents, ELL.d_max)
    return ObservedGroup(points_cam=points, tangents_cam=tangents, boundary=boundary, frame=frame)


def expected(T: Floats, group: ObservedGroup, symmetry: Symmetry | None = None, noise: float = NOISE) -> ExpectedError:
    config = JointRefinement(depth_noise=noise)
    return expected_error(T, symmetry or ELL.symmetry, MODEL, SURFACE, group, config)


def test_it_grows_with_the_noise_of_the_depth() -> None:
    group = seen(LEANING, np.random.default_rng(0))
    errors = [expected(LEANING, group, noise=noise) for noise in (0.0003, 0.001, 0.003)]
    rotations, translations = [e.rotation for e in errors], [e.translation for e in errors]
    assert 0 < rotations[0] < rotations[1] < rotations[2] < np.deg2rad(10)
    assert 0 < translations[0] < translations[1] < translations[2] < 0.01


def test_it_is_the_error_of_refinements_where_errors_are_independent() -> None:
    """Edges err by 0.7 px and each pixel of the depth by 2 mm, so that a mean of 25 errs by a fifth of that."""
    config = JointRefinement(depth_noise=NOISE, averaged=0.2)
    errors, foreseen = [], []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        group = seen(LEANING, rng)
        pixel = at.DISTANCE / group.frame.K[0, 0]
        sideways = config.edge_noise * pixel * rng.normal(size=group.points_cam.shape) * (1.0, 1.0, 0.0)
        boundary = index_boundary(group.points_cam + sideways, group.tangents_cam, ELL.d_max)
        group = replace(group, boundary=boundary)
        start = at.beside(LEANING, ELL, rng, 0.0005, np.radians(1.0))
        found = refine_jointly(start, MODEL, SURFACE, group, config).T_cam_part
        error = pose_error(found, LEANING, ELL)
        ahead = expected_error(found, ELL.symmetry, MODEL, SURFACE, group, config)
        foreseen.append((ahead.rotation / CORRELATED, ahead.translation / CORRELATED))
        errors.append((error.rotation, error.translation))
    # The errors are those along all three axes, the expected one is that of the worst.
    ratios = np.sqrt(np.mean(np.square(errors), axis=0)) / np.mean(foreseen, axis=0)
    assert ((ratios > 0.7) & (ratios < 1.6)).all(), ratios


def test_a_rotation_that_a_symmetry_undoes_does_not_count() -> None:
    """The rest is that of a part that is held in this rotation: never more than with it."""
    group = seen(LEANING, np.random.default_rng(1))
    free = expected(LEANING, group)
    about = [expected(LEANING, group, Symmetry(axis=axis)).rotation for axis in np.eye(3)]
    assert all(0 < rotation <= free.rotation for rotation in about)
    assert min(about) < 0.95 * free.rotation
    assert expected(LEANING, group, Symmetry(sphere=True)).rotation == 0.0


def test_without_any_match_nothing_is_known() -> None:
    group = seen(LEANING, np.random.default_rng(2))
    away = LEANING.copy()
    away[0, 3] += 0.03
    lost = replace(group, frame=at.framed(np.where(group.frame.depth > 0, 9.0, 0.0).astype(np.float32)))
    error = expected(away, lost)
    assert error.translation == pytest.approx(SURFACE.d_max, rel=0.01)
    assert error.rotation == pytest.approx(2.0, rel=0.01)


def test_it_does_not_depend_on_the_direction_of_the_camera() -> None:
    """Turning camera, scene and part together about the line of sight changes nothing but rounding and pixels."""
    group = seen(LEANING, np.random.default_rng(3))
    quarter = np.eye(4)
    quarter[:3, :3] = rotation_about((0.0, 0.0, 1.0), np.pi)
    points = transform_points(quarter, group.points_cam)
    tangents = group.tangents_cam @ quarter[:3, :3].T
    frame = group.frame
    K = frame.K.copy()
    height, width = frame.depth.shape
    K[0, 2], K[1, 2] = width - 1 - K[0, 2], height - 1 - K[1, 2]
    turned = ObservedGroup(
        points_cam=points,
        tangents_cam=tangents,
        boundary=index_boundary(points, tangents, ELL.d_max),
        frame=replace(frame, depth=np.ascontiguousarray(frame.depth[::-1, ::-1]), K=K, grey=None),
    )
    here, there = expected(LEANING, group), expected(quarter @ LEANING, turned)
    assert there.rotation == pytest.approx(here.rotation, rel=0.1)
    assert there.translation == pytest.approx(here.translation, rel=0.1)


def test_bad_input_is_refused() -> None:
    group = seen(LEANING, np.random.default_rng(4))
    with pytest.raises(ValueError, match="T_cam_part must be finite"):
        expected(np.full((4, 4), np.nan), group)
    blind = replace(group, frame=at.framed(np.zeros(at.SIZE[::-1], np.float32)))
    with pytest.raises(ValueError, match="the frame must have a depth somewhere"):
        expected(LEANING, blind)
