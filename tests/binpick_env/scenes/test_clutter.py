"""Visible fractions: silhouettes against closed forms and MuJoCo's rays, occlusion by construction."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from binpick_env.camera.depth_camera import Capture, DepthCamera
from binpick_env.config import BinConfig, CameraConfig
from binpick_env.scenes.clutter import ClutterStats, silhouette_pixels, visible_fractions
from perception.geometry import (
    Floats,
    camera_matrix,
    invert_transform,
    make_transform,
    random_rotation,
)
from tests.binpick_env.camera.camera_scene import BOX, CAMERA, Scene, build, random_poses, tee

WORKSPACE = BinConfig().workspace()
LARGE = CameraConfig()
K = camera_matrix(2400.0, 1280, 960)


def look(scene: Scene, config: CameraConfig = CAMERA) -> Capture:
    camera = DepthCamera(scene.model, config, scene.workspace, scene.instance_of_geom)
    return camera.capture(scene.data, np.random.default_rng(0))


def at_bin(*places: tuple[float, float, float]) -> Floats:
    return np.stack([WORKSPACE.T_world_bin @ make_transform(translation=p) for p in places])


# --- silhouettes


def test_silhouette_of_a_square_is_its_pixels_counted_by_hand() -> None:
    box = trimesh.creation.box((0.1, 0.05, 0.02))
    count = silhouette_pixels(box, make_transform(translation=(0.013, -0.021, 0.81))[None], K, (960, 1280))
    x, y = 2400 * np.array([0.013 - 0.05, 0.013 + 0.05]) / 0.8, 2400 * np.array([-0.021 - 0.025, -0.021 + 0.025]) / 0.8
    u, v = np.arange(1280) - K[0, 2], np.arange(960) - K[1, 2]
    assert count[0] == np.sum((u >= x[0]) & (u <= x[1])) * np.sum((v >= y[0]) & (v <= y[1]))


def test_silhouette_of_a_sphere_is_its_cone() -> None:
    radius, centre = 0.05, np.array([0.06, -0.04, 0.8])
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    u, v = np.meshgrid((np.arange(1280) - K[0, 2]) / 2400, (np.arange(960) - K[1, 2]) / 2400)
    along = u * centre[0] + v * centre[1] + centre[2]
    inside = along**2 >= (u**2 + v**2 + 1) * (centre @ centre - radius**2)
    count = silhouette_pixels(ball, make_transform(translation=centre)[None], K, (960, 1280))
    assert count[0] == pytest.approx(inside.sum(), rel=2e-3)


@pytest.mark.parametrize("seed", range(4))
def test_silhouettes_equal_mujocos_rays(seed: int) -> None:
    poses = random_poses(1, WORKSPACE, seed)
    scene = build(poses)
    camera = DepthCamera(scene.model, LARGE, scene.workspace, scene.instance_of_geom)
    capture = camera.capture(scene.data, np.random.default_rng(0), "none")
    T_cam_parts = invert_transform(camera.T_world_cam) @ poses
    rays = np.sum(capture.instance_ids == 0)  # nothing stands before a lone part
    assert silhouette_pixels(tee(), T_cam_parts, camera.K, (960, 1280))[0] == pytest.approx(rays, rel=2e-3)
    assert rays > 5000


def test_silhouettes_have_no_seams_and_do_not_depend_on_other_parts() -> None:
    rng = np.random.default_rng(2)
    poses = np.stack([make_transform(random_rotation(rng), (*rng.uniform(-0.1, 0.1, 2), 0.8)) for _ in range(12)])
    fine = tee().subdivide().subdivide()  # 16 times the triangles, the same surface
    together = silhouette_pixels(tee(), poses, K, (960, 1280))
    np.testing.assert_allclose(silhouette_pixels(fine, poses, K, (960, 1280)), together, atol=2)
    alone = [silhouette_pixels(tee(), pose[None], K, (960, 1280))[0] for pose in poses]
    np.testing.assert_array_equal(alone, together)


def test_silhouettes_end_at_the_region_and_behind_the_camera() -> None:
    box = trimesh.creation.box((0.02, 0.02, 0.02))
    poses = np.stack([make_transform(translation=(x, 0, z)) for x, z in ((0, 0.8), (0, -0.8), (9, 0.8), (0, 0.0))])
    counts = silhouette_pixels(box, poses, K, (960, 1280))
    assert counts[0] > 1000
    np.testing.assert_array_equal(counts[1:3], 0)
    assert counts[3] == 0  # the eye inside: no front face before it
    half = silhouette_pixels(box, poses[:1], K, (960, 1280), (0, 0, 640, 960))
    assert half[0] * 2 == counts[0]


# --- fractions


def test_a_lone_part_is_wholly_visible_and_a_missing_one_not_at_all() -> None:
    poses = at_bin((0.0, 0.02, 0.03), (3.0, 0.0, 0.03), (0.1, -0.05, -0.5))  # in the bin, out of view, under the table
    fractions = visible_fractions(look(build(poses)), tee(), poses)
    assert fractions[0] == pytest.approx(1.0, abs=2e-3)
    np.testing.assert_array_equal(fractions[1:], 0.0)


def test_a_lid_over_half_of_a_part_hides_half_of_it() -> None:
    box = trimesh.creation.box((0.08, 0.04, 0.02))
    poses = at_bin((0.0, 0.0, 0.01))
    lid = WORKSPACE.T_world_bin @ np.array([0.1, 0, 0.05, 1])  # its near edge in the camera's own plane x = 0
    extra = [{"type": BOX, "size": [0.1, 0.1, 0.005], "pos": lid[:3]}]
    fractions = visible_fractions(look(build(poses, box, extra)), box, poses)
    assert fractions[0] == pytest.approx(0.5, abs=0.01)


def test_fractions_equal_a_render_of_each_part_alone() -> None:
    poses = random_poses(7, WORKSPACE, seed=3)
    capture = look(build(poses))
    alone = [np.sum(look(build(pose[None])).instance_ids == 0) for pose in poses]
    seen = [np.sum(capture.instance_ids == i) for i in range(7)]
    fractions = visible_fractions(capture, tee(), poses)
    np.testing.assert_allclose(fractions, np.array(seen) / alone, atol=5e-3)
    assert fractions.min() < 0.9


def test_fractions_do_not_depend_on_the_sensor() -> None:
    scene = build(random_poses(4, WORKSPACE, seed=5))
    camera = DepthCamera(scene.model, CAMERA, scene.workspace, scene.instance_of_geom)
    captures = [camera.capture(scene.data, np.random.default_rng(0), preset) for preset in ("none", "harsh")]
    first, second = (visible_fractions(c, tee(), scene.T_world_parts) for c in captures)
    np.testing.assert_array_equal(first, second)


def test_an_empty_bin_has_no_fractions() -> None:
    nothing = np.zeros((0, 4, 4))
    assert visible_fractions(look(build(nothing)), tee(), nothing).shape == (0,)


def test_raster_gives_the_same_fractions() -> None:
    scene = build(random_poses(6, WORKSPACE, seed=6))
    rays, raster = (
        visible_fractions(look(scene, replace(CAMERA, backend=b)), tee(), scene.T_world_parts)
        for b in ("rays", "raster")
    )
    np.testing.assert_allclose(rays, raster, atol=2e-3)


# --- statistics and faults


def test_stats_by_hand() -> None:
    stats = ClutterStats.from_fractions([0.2, 0.5, 0.7, 0.9, 0.95])
    assert stats == ClutterStats(count=5, median=0.7, below_half=0.2, above_nine_tenths=0.2)
    empty = ClutterStats.from_fractions([])
    assert empty.count == 0
    assert np.isnan([empty.median, empty.below_half, empty.above_nine_tenths]).all()


def _with_nan() -> object:
    poses = at_bin((0, 0, 0.03), (0.1, 0, 0.03))
    poses[1, 0, 3] = np.nan
    return silhouette_pixels(tee(), poses, K, (960, 1280))


def _too_few_poses() -> object:
    poses = at_bin((0, 0, 0.03), (0.1, 0, 0.03))
    return visible_fractions(look(build(poses)), tee(), poses[:1])


def _open_mesh() -> object:
    mesh = tee()
    return silhouette_pixels(trimesh.Trimesh(mesh.vertices, mesh.faces[1:]), np.eye(4)[None], K, (960, 1280))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (_with_nan, "the pose of part 1 is not finite"),
        (_too_few_poses, "the capture shows part 1, but there are only 1 poses"),
        (_open_mesh, "mesh must be watertight"),
        (lambda: silhouette_pixels(tee(), np.eye(4), K, (9, 9)), r"T_cam_parts must be \(N, 4, 4\), got \(4, 4\)"),
        (lambda: ClutterStats.from_fractions(np.zeros((2, 2))), r"fractions must be \(N,\), got \(2, 2\)"),
    ],
)
def test_mistakes_are_named(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
