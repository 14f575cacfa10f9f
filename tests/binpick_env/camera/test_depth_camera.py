"""The depth camera: geometry against closed forms and MuJoCo's single ray, backends against each other."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh

from binpick_env.camera.depth_camera import Capture, default_pose
from binpick_env.camera.egl import NEAR_CLIP, near_plane
from binpick_env.camera.shading import Light
from binpick_env.camera.view import View
from perception.geometry import (
    Floats,
    deproject_depth,
    invert_transform,
    make_transform,
    project_points,
    transform_points,
)
from tests.binpick_env.camera.camera_scene import BOX, CAMERA, SPHERE, Scene, build, random_poses
from tests.binpick_env.camera.camera_views import WORKSPACE, egl_works, look, make_camera, tilted

# --- geometry in closed form


def test_depth_is_along_the_optical_axis(backend: str) -> None:
    capture = look(build(np.zeros((0, 4, 4))), backend)
    centre, floor = (180, 240), capture.depth_true[150:210:10, 180:300:10]
    assert capture.depth_true[centre] == pytest.approx(0.9, abs=2e-5)
    np.testing.assert_allclose(floor, 0.9, atol=2e-5)  # also far off the axis, where the ray is longer
    rim = project_points(capture.frame.K, np.array([[0.19, 0.0, 0.78]]))[0]
    assert capture.depth_true[round(rim[1]), round(rim[0])] == pytest.approx(0.78, abs=2e-5)
    assert np.all(capture.instance_ids == -1)


@pytest.mark.parametrize("pose", [None, tilted()], ids=["above", "tilted"])
def test_no_axis_is_flipped(backend: str, pose: Floats | None) -> None:
    places = np.array([[0.12, 0.06, 0.05], [-0.11, 0.07, 0.02], [0.03, -0.09, 0.08]])  # no two mirror each other
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.012)
    scene = build(np.stack([WORKSPACE.T_world_bin @ make_transform(translation=p) for p in places]), ball)
    capture = look(scene, backend, pose)
    T_cam_world = invert_transform(capture.frame.T_world_cam)
    wanted = project_points(capture.frame.K, transform_points(T_cam_world, scene.T_world_parts[:, :3, 3]))
    for i, pixel in enumerate(wanted):
        v, u = np.nonzero(capture.instance_ids == i)
        np.testing.assert_allclose([u.mean(), v.mean()], pixel, atol=0.3)


def test_default_pose_looks_down_along_the_bins_axes() -> None:
    T_bin_cam = invert_transform(WORKSPACE.T_world_bin) @ default_pose(WORKSPACE, 0.9)
    np.testing.assert_allclose(T_bin_cam[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-12)
    np.testing.assert_allclose(T_bin_cam[:3, 3], (0, 0, 0.9), atol=1e-12)


def test_depth_deprojects_onto_the_floor(backend: str) -> None:
    capture = look(build(np.zeros((0, 4, 4))), backend, tilted())
    points = deproject_depth(capture.frame.K, capture.depth_true)[capture.depth_true > 0]
    points_bin = WORKSPACE.to_bin(transform_points(capture.frame.T_world_cam, points))
    inner = np.all(np.abs(points_bin[:, :2]) < WORKSPACE.inner_size[:2] / 2 - 0.005, axis=1)
    assert inner.sum() > 5000
    np.testing.assert_allclose(points_bin[inner, 2], 0.0, atol=5e-5)


def test_a_sphere_has_its_depth_and_normals() -> None:
    centre_bin, radius = np.array([0.05, 0.03, 0.06]), 0.04
    centre_world = transform_points(WORKSPACE.T_world_bin, centre_bin[None])[0]
    capture = look(build(np.zeros((0, 4, 4)), extra=[{"type": SPHERE, "size": [radius, 0, 0], "pos": centre_world}]))
    centre = transform_points(invert_transform(capture.frame.T_world_cam), centre_world[None])[0]
    rays = deproject_depth(capture.frame.K, np.ones_like(capture.depth_true))
    square, along = np.sum(rays**2, axis=-1), rays @ centre
    under_root = along**2 - square * (centre @ centre - radius**2)
    hit = under_root > 1e-6
    depth = (along - np.sqrt(np.maximum(under_root, 0))) / square
    np.testing.assert_allclose(capture.depth_true[hit], depth[hit], atol=1e-6)
    normals = (rays * depth[..., None] - centre) / radius
    np.testing.assert_allclose(capture.normals[hit], normals[hit], atol=1e-3)


# --- against MuJoCo's single ray, and backends against each other


@pytest.mark.parametrize("pose", [None, tilted()], ids=["above", "tilted"])
def test_rays_equal_single_rays(pile: Scene, pose: Floats | None) -> None:
    capture = look(pile, pose=pose)
    rng = np.random.default_rng(3)
    u0, v0, u1, v1 = capture.region
    eye, R = capture.frame.T_world_cam[:3, 3], capture.frame.T_world_cam[:3, :3]
    group, geom = np.eye(6, dtype=np.uint8)[2], np.zeros(1, np.int32)
    pixels = np.stack([rng.integers(u0, u1, 4000), rng.integers(v0, v1, 4000)], axis=1)
    rays = np.column_stack([(pixels - capture.frame.K[:2, 2]) / capture.frame.K[0, 0], np.ones(4000)]) @ R.T
    for (u, v), ray in zip(pixels, rays, strict=True):
        depth = mujoco.mj_ray(pile.model, pile.data, eye, ray, group, 1, -1, geom)
        assert capture.depth_true[v, u] == pytest.approx(max(depth, 0.0), abs=1e-6)
        assert capture.instance_ids[v, u] == pile.instance_of_geom[geom[0]]


@pytest.mark.parametrize("other", ["raster", "egl"])
@pytest.mark.parametrize("pose", [None, tilted()], ids=["above", "tilted"])
def test_backends_agree_with_rays(pile: Scene, other: str, pose: Floats | None) -> None:
    if other == "egl" and not egl_works():
        pytest.skip("no EGL driver on this machine (libegl1, libgl1-mesa-dri)")
    rays, fast = look(pile, pose=pose), look(pile, other, pose)
    same = rays.instance_ids == fast.instance_ids
    assert np.mean(~same) < 1e-3
    assert np.mean(np.abs(rays.depth_true - fast.depth_true) > 1e-5) < 1e-3
    grey = np.abs(rays.frame.grey.astype(int) - fast.frame.grey)
    assert np.mean(grey > 2) < 2e-3
    assert len(np.unique(rays.instance_ids)) == 9


def off_centre(scene: Scene, backend: str) -> Capture:
    """Return a capture by a camera whose optical axis meets the image far from its middle."""
    camera = make_camera(scene, replace(CAMERA, backend=backend))
    camera.K = camera.K + np.array([[0.0, 0.0, 31.25], [0.0, 40.0, -17.5], [0.0, 0.0, 0.0]])
    capture = camera.capture(scene.data, np.random.default_rng(0), "none")
    camera.close()
    return capture


@pytest.mark.parametrize("other", ["raster", "egl"])
def test_backends_agree_with_rays_off_the_images_centre(pile: Scene, other: str) -> None:
    if other == "egl" and not egl_works():
        pytest.skip("no EGL driver on this machine (libegl1, libgl1-mesa-dri)")
    rays, fast = off_centre(pile, "rays"), off_centre(pile, other)
    assert np.mean(rays.instance_ids != fast.instance_ids) < 1e-3
    assert np.mean(np.abs(rays.depth_true - fast.depth_true) > 1e-5) < 1e-3
    centred = look(pile)
    assert np.mean(rays.instance_ids != centred.instance_ids) > 0.02


def test_the_near_plane_of_gl_is_what_the_image_covers_of_it() -> None:
    """Each corner of the image, half a pixel outside of the corner pixel's centre, projects onto the near plane."""
    K = np.array([[520.0, 0.0, 251.5], [0.0, 610.0, 139.25], [0.0, 0.0, 1.0]])
    empty = np.zeros((0, 3))
    view = View(K=K, width=480, height=360, region=np.zeros(4, np.int64), rotations=empty, positions=empty)
    plane = near_plane(view)
    for corner, x, y in [
        ((-0.5, -0.5), plane.centre - plane.half_width, plane.top),
        ((479.5, 359.5), plane.centre + plane.half_width, plane.bottom),
    ]:
        ray = np.linalg.inv(K) @ (*corner, 1.0)  # camera frame, y down
        np.testing.assert_allclose((x, -y), NEAR_CLIP * ray[:2], atol=1e-15)


def test_the_near_plane_of_a_centred_camera_is_symmetric() -> None:
    empty = np.zeros((0, 3))
    K = make_camera(build(np.zeros((0, 4, 4)))).K
    size = {"width": CAMERA.width, "height": CAMERA.height}
    plane = near_plane(View(K=K, **size, region=np.zeros(4, np.int64), rotations=empty, positions=empty))
    assert plane.centre == 0.0
    assert plane.bottom == -plane.top
    assert plane.half_width / plane.top == pytest.approx(CAMERA.width / CAMERA.height)


def test_rays_do_not_depend_on_threads(pile: Scene) -> None:
    captures = [make_camera(pile, threads=n).capture(pile.data, np.random.default_rng(5)) for n in (1, 2, 3, None)]
    for capture in captures[1:]:
        for name in ("depth_true", "instance_ids", "normals"):
            np.testing.assert_array_equal(getattr(capture, name), getattr(captures[0], name))
        np.testing.assert_array_equal(capture.frame.depth, captures[0].frame.depth)
        np.testing.assert_array_equal(capture.frame.grey, captures[0].frame.grey)


def test_the_seed_moves_the_depth_alone(pile: Scene) -> None:
    camera = make_camera(pile)
    first, again, other = (camera.capture(pile.data, np.random.default_rng(s)) for s in (7, 7, 8))
    np.testing.assert_array_equal(first.frame.depth, again.frame.depth)
    assert not np.array_equal(first.frame.depth, other.frame.depth)
    np.testing.assert_array_equal(first.frame.grey, other.frame.grey)
    np.testing.assert_array_equal(first.depth_true, other.depth_true)


def test_a_capture_changes_neither_model_nor_data(pile: Scene) -> None:
    before = pile.data.geom_xpos.copy(), pile.model.geom_group.copy(), pile.model.body_geomnum.copy()
    look(pile)
    after = pile.data.geom_xpos, pile.model.geom_group, pile.model.body_geomnum
    for a, b in zip(before, after, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_moved_part_is_seen_where_it_went() -> None:
    scene = build(random_poses(1, WORKSPACE, seed=2))
    camera = make_camera(scene)
    before = camera.capture(scene.data, np.random.default_rng(0)).instance_ids
    scene.data.qpos[1] += 0.05
    mujoco.mj_kinematics(scene.model, scene.data)
    after = camera.capture(scene.data, np.random.default_rng(0)).instance_ids
    assert abs(np.nonzero(after == 0)[1].mean() - np.nonzero(before == 0)[1].mean()) > 20


# --- what is seen


@pytest.mark.parametrize("hidden", [{"group": 3}, {"rgba": [1, 1, 1, 0]}], ids=["collision", "transparent"])
def test_invisible_geoms_are_not_seen(backend: str, hidden: dict[str, object]) -> None:
    lid = {"type": BOX, "size": [0.1, 0.1, 0.01], "pos": [0.5, 0, 0.2]}
    open_, covered, still_open = (
        look(build(np.zeros((0, 4, 4)), extra=extra), backend).depth_true for extra in ([], [lid], [{**lid, **hidden}])
    )
    assert not np.allclose(open_, covered)
    np.testing.assert_array_equal(open_, still_open)


def test_a_geom_beside_the_eye_does_not_hide_the_rest(backend: str) -> None:
    # It straddles the camera's own plane, so that it has no outline in the image.
    beside = {"type": BOX, "size": [0.05, 0.05, 0.3], "pos": [0.5, 0.5, 0.9]}
    with_, without = (look(build(np.zeros((0, 4, 4)), extra=e), backend).depth_true for e in ([beside], []))
    np.testing.assert_allclose(with_, without, atol=1e-6)


def test_an_unbounded_plane_is_seen_by_rays() -> None:
    plane = {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": [0, 0, 0.1], "pos": [0, 0, 0.05]}
    capture = look(build(np.zeros((0, 4, 4)), extra=[plane]))
    assert capture.depth_true[180, 240] == pytest.approx(0.9 - 0.03, abs=1e-6)


def test_outside_the_bins_region_there_is_nothing() -> None:
    scene = build(np.zeros((0, 4, 4)))
    camera = make_camera(scene, replace(CAMERA, focal=1200.0))
    capture = camera.capture(scene.data, np.random.default_rng(0), light=Light(background=17))
    u0, v0, u1, v1 = capture.region
    outside = np.ones((360, 480), bool)
    outside[v0:v1, u0:u1] = False
    assert outside.sum() > 10_000
    assert np.all(capture.depth_true[outside] == 0)
    assert np.all(capture.frame.grey[outside] == 17)
    assert np.all(capture.depth_true[~outside] > 0)


def test_a_pixel_without_a_surface_belongs_to_no_geom(backend: str) -> None:
    """Not to the model's first geom either, which is an instance here."""
    scene = build(np.zeros((0, 4, 4)))
    scene = replace(scene, instance_of_geom=np.arange(scene.model.ngeom))
    camera = make_camera(scene, replace(CAMERA, focal=1200.0, backend=backend))
    capture = camera.capture(scene.data, np.random.default_rng(0), "none")
    camera.close()
    nothing = capture.depth_true == 0
    assert nothing.sum() > 10_000
    assert np.all(capture.instance_ids[nothing] == -1)
    assert np.all(capture.instance_ids[~nothing] >= 0)


@pytest.mark.parametrize("away", [make_transform(translation=(2.0, 0, 0)), make_transform(np.diag([1.0, -1, -1]))])
def test_a_bin_out_of_view_gives_an_empty_frame(backend: str, away: Floats, pile: Scene) -> None:
    capture = look(pile, backend, default_pose(WORKSPACE, 0.9) @ away, sensor="good")
    assert not capture.frame.valid.any()
    assert np.all(capture.instance_ids == -1)
    assert np.all(capture.frame.grey == 0)
