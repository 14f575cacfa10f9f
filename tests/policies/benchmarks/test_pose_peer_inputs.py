"""All methods are given the same segments and bins, as boundary points and as surfaces."""

from dataclasses import replace

import numpy as np
import pytest

from binpick_env.config import CameraConfig, CellConfig
from binpick_env.scenes.synthesis import CapturedScene, SceneConfig, make_scene
from perception.geometry import invert_transform, transform_points
from policies.benchmarks.pose_peer_inputs import model_points, pose_cases, segment_cases, whole_case, with_normals
from tests.policies.benchmarks.pose_peer_cases import TEE, case


@pytest.fixture(scope="module")
def made() -> CapturedScene:
    config = SceneConfig(part="tee", seed=31, num_parts=(4, 4), camera=CameraConfig(width=640, height=480))
    return make_scene(config, 0)


def test_normals_are_those_of_the_surface_towards_the_camera() -> None:
    rng = np.random.default_rng(0)
    plane = np.column_stack([rng.uniform(-0.05, 0.05, (500, 2)), np.full(500, 0.8)])
    plane[:, 2] += 0.5 * plane[:, 0]
    points = with_normals(plane)
    np.testing.assert_array_equal(points[:, :3], plane)
    expected = np.array([0.5, 0, -1]) / np.hypot(0.5, 1)
    np.testing.assert_allclose(points[:, 3:], np.tile(expected, (500, 1)), atol=1e-9)


def test_segments_are_the_true_parts_measured_surface(made: CapturedScene) -> None:
    cases = segment_cases(made, 5, expected=500.0)
    assert len(cases) == 3
    for found in cases:
        assert (found.scene, found.top, found.to_find.tolist()) == (5, 1, [True])
        assert found.instance is not None
        (part,) = set(made.scene.instance_ids[found.instance.point_idx])
        np.testing.assert_array_equal(found.T_cam_parts[0], made.scene.T_cam_parts[part])
        points_part = transform_points(invert_transform(found.T_cam_parts[0]), found.points[:, :3])
        low, high = TEE.mesh.bounds
        assert (points_part > low - 0.002).all()
        assert (points_part < high + 0.002).all()
        assert len(found.points) > 1000
        assert (np.einsum("ni,ni->n", found.points[:, :3], found.points[:, 3:]) <= 0).all()


def test_segments_are_those_nearest_to_a_whole_parts_size(made: CapturedScene) -> None:
    sizes = np.bincount(made.scene.instance_ids[made.scene.instance_ids >= 0])
    depth = float(np.median(made.scene.boundary.points_cam[:, 2]))
    first = segment_cases(made, 0, expected=depth * int(sizes.max()))[0]
    assert first.instance is not None
    assert len(first.instance.point_idx) == sizes.max()
    bare = made._replace(scene=replace(made.scene, instance_ids=np.full_like(made.scene.instance_ids, -1)))
    assert segment_cases(bare, 0, expected=500.0) == []


def test_a_whole_bin_is_everything_in_it_but_the_container(made: CapturedScene) -> None:
    whole = whole_case(made, 2, CellConfig().bin.workspace())
    assert (whole.scene, whole.instance, whole.top) == (2, None, 4)
    np.testing.assert_array_equal(whole.T_cam_parts, made.scene.T_cam_parts)
    np.testing.assert_array_equal(whole.to_find, made.scene.visible_fractions >= 0.5)
    frame = made.capture.frame
    world = transform_points(frame.T_world_cam, whole.points[:, :3])
    assert CellConfig().bin.workspace().contains(world, margin=0.003, headroom=0.03).all()
    parts = int((frame.valid & (made.capture.instance_ids >= 0)).sum())
    assert 0.9 * parts < len(whole.points) < 1.1 * parts


def test_model_points_lie_on_the_mesh_with_normals_outwards() -> None:
    points = model_points(TEE)
    assert len(points) > 5000
    np.testing.assert_allclose(np.linalg.norm(points[:, 3:], axis=1), 1)
    outside = points[:, :3] + 1e-4 * points[:, 3:]
    inside = points[:, :3] - 1e-4 * points[:, 3:]
    assert not TEE.mesh.contains(outside[::100]).any()
    assert TEE.mesh.contains(inside[::100]).all()


@pytest.mark.parametrize(("count", "whole"), [(0, 0), (1, 2), (1, -1)])
def test_impossible_numbers_of_scenes_are_refused(count: int, whole: int) -> None:
    with pytest.raises(ValueError, match=f"whole_scenes from 0 to it, got {count} and {whole}"):
        pose_cases(SceneConfig(seed=31), count, whole)


def test_nonsense_is_refused() -> None:
    with pytest.raises(ValueError, match="top and parts must be at least 1, got 0 and 1"):
        case(top=0)
    with pytest.raises(ValueError, match="top and parts must be at least 1, got 1 and 0"):
        case(np.zeros((0, 4, 4)))
    with pytest.raises(ValueError, match=r"points must be \(N, 6\), got \(5, 3\)"):
        case(points=np.ones((5, 3)))
    with pytest.raises(ValueError, match="a plane needs at least 3 points, got 2"):
        with_normals(np.ones((2, 3)))
