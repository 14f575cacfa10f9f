"""What a camera refuses, and in which words."""

import importlib
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh

from binpick_env.camera.depth_camera import DepthCamera, default_pose
from binpick_env.camera.shading import Light
from binpick_env.config import CameraConfig
from perception.frame import Workspace
from perception.geometry import (
    make_transform,
)
from tests.binpick_env.camera.camera_scene import CAMERA, MESH, SPHERE, Scene, build, random_poses
from tests.binpick_env.camera.camera_views import WORKSPACE, egl_works, look, make_camera


def test_a_pose_that_is_not_finite_names_its_body(backend: str) -> None:
    scene = build(random_poses(3, WORKSPACE, seed=1))
    scene.data.geom_xpos[scene.model.geom("part_1/visual").id, 0] = np.nan
    with pytest.raises(ValueError, match="pose of body 'part_1' is not finite"):
        look(scene, backend)


def _flat(scene: Scene) -> DepthCamera:
    return DepthCamera(scene.model, CAMERA, scene.workspace, np.zeros(3, np.int64))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (_flat, r"instance_of_geom must be \(ngeom,\) = \(\d+,\), got \(3,\)"),
        (lambda s: make_camera(s, pose=np.eye(3)), r"T_world_cam must be \(4, 4\), got \(3, 3\)"),
        (lambda s: make_camera(s, pose=np.full((4, 4), np.nan)), "T_world_cam must be finite"),
        (lambda s: make_camera(s, threads=0), "threads must be at least 1, got 0"),
        (
            lambda s: make_camera(s).capture(build(np.zeros((0, 4, 4))).data, np.random.default_rng(0)),
            r"data has \d+ geo",
        ),
        (
            lambda s: look(s, sensor="nice"),
            "none, good, harsh, stereo, tof or a DepthSensor, got 'nice'",
        ),
        (lambda _: Light(to_light=(0, 0, 0)), "to_light must be a finite vector that is not zero"),
        (lambda _: Light(ambient=1.5), r"ambient must be in \[0, 1\], got 1.5"),
        (lambda _: Light(radius=0), "reference and radius must be positive"),
        (lambda _: Light(background=256), "background must be in 0 to 255, got 256"),
        (lambda _: CameraConfig(backend="cuda"), "backend must be one of rays, egl, raster, got 'cuda'"),
    ],
)
def test_mistakes_are_named(pile: Scene, call: Callable[[Scene], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call(pile)


def test_the_models_first_face_is_drawn() -> None:
    """A plate whose first two triangles are its top."""
    plate = trimesh.creation.box((0.2, 0.1, 0.02))
    order = np.argsort(-plate.face_normals[:, 2], kind="stable")
    spec = mujoco.MjSpec()
    faces = plate.faces[order].ravel().astype(np.int32)
    spec.add_mesh(name="plate", uservert=plate.vertices.ravel(), userface=faces)
    place = WORKSPACE.T_world_bin[:3, 3] + [0, 0, 0.05]
    spec.worldbody.add_geom(type=MESH, meshname="plate", pos=place, group=2)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = DepthCamera(model, replace(CAMERA, backend="raster"), WORKSPACE, np.zeros(1, np.int64), threads=1)
    capture = camera.capture(data, np.random.default_rng(0), "none")
    assert np.count_nonzero(capture.depth_true) > 5000
    np.testing.assert_array_equal(capture.instance_ids, np.where(capture.depth_true > 0, 0, -1))


def test_raster_refuses_what_it_cannot_draw() -> None:
    scene = build(np.zeros((0, 4, 4)), extra=[{"name": "ball", "type": SPHERE, "size": [0.1, 0, 0]}])
    with pytest.raises(ValueError, match=r"'raster' draws meshes and boxes, but there are ball \(sphere\); use 'rays'"):
        look(scene, "raster")


def test_egl_without_a_driver_names_the_alternative(pile: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: str) -> None:
        raise AttributeError("'NoneType' object has no attribute 'eglQueryString'")

    monkeypatch.setattr(importlib, "import_module", broken)
    with pytest.raises(RuntimeError, match=r"needs a working EGL driver .* 'rays' and 'raster' need no GL"):
        look(pile, "egl")


def test_two_egl_cameras_take_turns(pile: Scene) -> None:
    if not egl_works():
        pytest.skip("no EGL driver on this machine (libegl1, libgl1-mesa-dri)")
    empty = build(np.zeros((0, 4, 4)))
    config = replace(CAMERA, backend="egl")
    cameras = {True: make_camera(pile, config), False: make_camera(empty, config)}
    for full in (True, False, True):
        scene = pile if full else empty
        capture = cameras[full].capture(scene.data, np.random.default_rng(0))
        assert (capture.instance_ids >= 0).any() == full
    for camera in cameras.values():
        camera.close()
        camera.close()


def test_workspace_of_another_pose_moves_the_camera() -> None:
    shifted = Workspace(T_world_bin=make_transform(translation=(1.0, 2.0, 3.0)), inner_size=np.array([0.3, 0.2, 0.1]))
    np.testing.assert_allclose(default_pose(shifted, 0.5)[:3, 3], (1.0, 2.0, 3.5))


def test_a_bin_that_lies_partly_outside_the_image_is_said_once(caplog: pytest.LogCaptureFixture) -> None:
    scene = build(random_poses(1, WORKSPACE, seed=1))
    near, enough = (replace(CAMERA, distance=distance) for distance in (0.7, 0.8))
    for config in (enough, near, near):
        DepthCamera(scene.model, config, WORKSPACE, scene.instance_of_geom, threads=1).close()
    text = (
        "a bin of 360 x 260 x 120 mm lies partly outside the image of a camera 0.7 m above its floor: its rim is seen"
    )
    assert caplog.text.count("outside the image") == caplog.text.count(text) == 1
    needed = float(caplog.text.split("its rim is seen from ")[1].split(" m on")[0])
    view = np.array([CAMERA.width, CAMERA.height]) / CAMERA.focal_px * (needed - 0.12)
    assert (view >= (0.36 - 0.01, 0.26 - 0.01)).all()
    assert (view < (0.36 + 0.02, 0.26 + 0.02)).any()


@pytest.mark.parametrize("focal", [2100.0, 2180.0, 2240.0])
def test_from_the_distance_that_the_warning_names_nothing_is_unseen(
    focal: float, caplog: pytest.LogCaptureFixture
) -> None:
    scene = build(np.zeros((0, 4, 4)))
    config = replace(CAMERA, focal=focal, distance=0.5)
    make_camera(scene, config).close()
    needed = float(caplog.text.split("its rim is seen from ")[1].split(" m on")[0])
    caplog.clear()
    make_camera(scene, replace(config, distance=needed)).close()
    assert not caplog.text
