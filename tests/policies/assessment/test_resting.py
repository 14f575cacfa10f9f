"""Resting poses of parts whose shares are known, modulo symmetry, and where they lie."""

import numpy as np
import pytest
import trimesh

from binpick_env.parts import detect_symmetry, load_part
from perception.geometry import transform_points
from perception.part import PartModel, Symmetry
from policies.assessment.resting import resting_poses


def solid_angle(a: float, b: float, height: float) -> float:
    """Return the share of the sphere that a rectangle a x b covers, seen from ``height`` below its centre."""
    return float(4 * np.arcsin(a * b / np.sqrt((a**2 + 4 * height**2) * (b**2 + 4 * height**2)))) / (4 * np.pi)


def test_a_cube_rests_on_one_face_of_six_or_on_one_of_one() -> None:
    cube = trimesh.creation.box((0.05, 0.05, 0.05))
    poses = resting_poses(PartModel.from_mesh("cube", cube))
    assert [pose.share for pose in poses] == pytest.approx([1 / 6] * 6)
    (pose,) = resting_poses(PartModel.from_mesh("cube", cube, detect_symmetry(cube)))
    assert (pose.share, pose.height) == pytest.approx((1.0, 0.05))


def test_a_tall_block_falls_over_from_most_sides_and_a_flat_one_rests_on_its_largest_faces() -> None:
    flat = PartModel.from_mesh("flat", trimesh.creation.box((0.06, 0.05, 0.01)))
    poses = resting_poses(flat)
    assert poses[0].height == pytest.approx(0.01)
    assert poses[0].share == pytest.approx(poses[1].share)
    assert poses[0].share >= solid_angle(0.06, 0.05, 0.005)  # what rolls over edges is added
    assert sum(pose.share for pose in poses) == pytest.approx(1.0, abs=0.02)


def test_a_round_part_rests_on_its_side_once() -> None:
    rod = trimesh.creation.cylinder(radius=0.01, height=0.08, sections=48)
    group = Symmetry(axis=np.array([0.0, 0.0, 1.0]), rotations=np.stack([np.eye(3), np.diag([1.0, -1.0, -1.0])]))
    side, *ends = resting_poses(PartModel.from_mesh("rod", rod, group))
    assert side.share > 0.85
    assert side.height == pytest.approx(0.02, rel=0.01)
    assert sum(end.share for end in ends) == pytest.approx(1 - side.share, abs=0.01)


def test_a_ball_rests_anyhow() -> None:
    ball = PartModel.from_mesh("ball", trimesh.creation.icosphere(radius=0.02), Symmetry(sphere=True))
    (pose,) = resting_poses(ball)
    assert (pose.share, pose.height) == (1.0, ball.d_max)


def test_a_part_at_rest_touches_the_floor_with_its_up_direction_up() -> None:
    model = load_part("bracket").model
    for pose in resting_poses(model):
        T = pose.T_floor_part(model)
        np.testing.assert_allclose(T[:3, :3] @ pose.up, (0, 0, 1), atol=1e-12)
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(T[:3, :3]) > 0
        heights = transform_points(T, np.asarray(model.mesh.vertices))[:, 2]
        assert (heights.min(), heights.max()) == pytest.approx((0.0, pose.height), abs=1e-9)
        np.testing.assert_allclose(transform_points(T, model.centre[None])[0, :2], 0, atol=1e-12)
