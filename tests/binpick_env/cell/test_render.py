"""Pictures for people: what is in them, how the camera is turned, and what happens without GL or a display."""

import logging
import sys
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from binpick_env.cell.render import CellRenderer, PicturePainter, default_viewpoint, look_at
from binpick_env.cell.simulation import Simulation
from perception.geometry import Floats, camera_matrix, invert_transform, project_points, transform_points
from tests.binpick_env.small_cell import small_simulation

SKY = (232, 236, 240)
coordinate = st.floats(-3.0, 3.0)


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    simulation = small_simulation()
    mujoco.mj_forward(simulation.model, simulation.data)
    return simulation


@pytest.fixture(scope="module")
def painter(simulation: Simulation) -> PicturePainter:
    return PicturePainter(simulation)


@pytest.fixture
def no_gl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)


# --- the camera


def test_look_at_by_hand() -> None:
    T = look_at(np.array([1.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(T[:3, 2], (-1, 0, 0), atol=1e-12)  # forward, towards the target
    np.testing.assert_allclose(T[:3, 1], (0, 0, -1), atol=1e-12)  # the image's y runs down
    np.testing.assert_allclose(T[:3, 0], (0, 1, 0), atol=1e-12)
    np.testing.assert_array_equal(T[:3, 3], (1, 0, 1))


@given(st.tuples(coordinate, coordinate, coordinate), st.tuples(coordinate, coordinate, coordinate))
def test_look_at_points_at_the_target_and_keeps_the_world_upright(
    eye: tuple[float, ...], to: tuple[float, ...]
) -> None:
    here, target = np.array(eye), np.array(to)
    if np.linalg.norm((target - here)[:2]) < 0.01:
        return  # straight up or down there is no upright
    T = look_at(here, target)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    above = np.array([0.0, 0.0, 0.01])
    seen = transform_points(invert_transform(T), np.stack([target, target + above]))
    np.testing.assert_allclose(seen[0], (0, 0, np.linalg.norm(target - here)), atol=1e-9)
    assert seen[1, 1] < 0  # above the target is up in the image
    assert seen[1, 0] == pytest.approx(0.0, abs=1e-9)


def test_the_default_view_holds_bin_tray_and_tcp(simulation: Simulation) -> None:
    K = camera_matrix(1.05 * 640, 640, 480)
    places = np.stack([*(simulation.data.body(name).xpos for name in ("bin", "tray")), simulation.T_world_tcp[:3, 3]])
    points_cam = transform_points(invert_transform(default_viewpoint(simulation)), places)
    assert points_cam[:, 2].min() > 0.5
    pixels = project_points(K, points_cam)
    assert np.all((pixels > 30) & (pixels < np.array([640, 480]) - 30))


# --- the painter


def pixel_of(point_world: Floats, T_world_cam: Floats, width: int, height: int) -> tuple[int, int]:
    K = camera_matrix(1.05 * width, width, height)
    u, v = np.round(project_points(K, transform_points(invert_transform(T_world_cam), point_world[None])))[0].astype(
        int
    )
    return v, u


def hue(colour: np.ndarray) -> np.ndarray:
    """Return a colour without its brightness."""
    return np.asarray(colour, float) / np.linalg.norm(colour)


def test_a_picture_shows_the_colours_of_what_stands_there(simulation: Simulation, painter: PicturePainter) -> None:
    target = np.array([0.45, -0.2, 0.0])
    T_world_cam = look_at(np.array([0.76, -0.2, 1.6]), target)
    picture = painter.paint(T_world_cam, 320, 240)
    assert (picture.shape, picture.dtype) == ((240, 320, 3), np.uint8)
    spots = {
        "bin": (np.array([0.5, 0.02, 0.02]), (0.32, 0.36, 0.42)),
        "tray": (np.array([0.52, -0.5, 0.01]), (0.3, 0.42, 0.34)),
        "table": (np.array([0.85, -0.1, 0.0]), (0.55, 0.5, 0.45)),
    }
    for name, (point, rgb) in spots.items():
        colour = picture[pixel_of(point, T_world_cam, 320, 240)]
        np.testing.assert_allclose(hue(colour), hue(np.array(rgb)), atol=0.01, err_msg=name)


def test_a_picture_shows_the_arm_and_the_sky(simulation: Simulation, painter: PicturePainter) -> None:
    T_world_cam = default_viewpoint(simulation)
    before = painter.paint(T_world_cam, 320, 240)
    assert np.any(np.all(before == SKY, axis=-1)) or before.std() > 20
    elbow = pixel_of(simulation.data.body("wrist_2_link").xpos, T_world_cam, 320, 240)
    moved = simulation.data.qpos.copy()
    simulation.data.qpos[simulation.model.joint("shoulder_pan_joint").qposadr[0]] += 2.0
    mujoco.mj_forward(simulation.model, simulation.data)
    after = painter.paint(T_world_cam, 320, 240)
    simulation.data.qpos[:] = moved
    mujoco.mj_forward(simulation.model, simulation.data)
    assert np.any(before[elbow] != after[elbow])
    assert np.mean(np.any(before != after, axis=-1)) > 0.05
    np.testing.assert_array_equal(painter.paint(T_world_cam, 320, 240), before)


def test_above_the_horizon_there_is_sky(painter: PicturePainter) -> None:
    up = look_at(np.array([3.0, 3.0, 1.0]), np.array([4.0, 4.0, 1.5]))
    np.testing.assert_array_equal(np.unique(painter.paint(up, 64, 48).reshape(-1, 3), axis=0), [SKY])


def test_a_longer_focal_length_sees_less(painter: PicturePainter, simulation: Simulation) -> None:
    T_world_cam = look_at(np.array([0.5, 0.001, 1.5]), np.array([0.501, 0.0, 0.0]))
    wide, narrow = (painter.paint(T_world_cam, 160, 120, focal_px=f) for f in (80.0, 600.0))
    assert len(np.unique(wide.reshape(-1, 3), axis=0)) > len(np.unique(narrow.reshape(-1, 3), axis=0))


def test_pictures_are_the_same_each_time(simulation: Simulation, painter: PicturePainter) -> None:
    T_world_cam = default_viewpoint(simulation)
    again = PicturePainter(simulation).paint(T_world_cam, 320, 240)
    np.testing.assert_array_equal(painter.paint(T_world_cam, 320, 240), again)


# --- what render modes use


def test_without_gl_pictures_are_painted_and_said_to_be(
    simulation: Simulation, no_gl: None, caplog: pytest.LogCaptureFixture
) -> None:
    renderer = CellRenderer(simulation, 320, 240)
    with caplog.at_level(logging.INFO):
        first, second = renderer.picture(), renderer.picture()
    assert (first.shape, first.dtype) == ((240, 320, 3), np.uint8)
    np.testing.assert_array_equal(first, second)
    (record,) = caplog.records
    assert record.message.startswith("no OpenGL (MUJOCO_GL is not set): pictures are rasterised on the CPU; set MUJOCO")
    renderer.close()


def test_gl_that_fails_is_given_up_once(
    simulation: Simulation, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    calls = []

    def broken(*arguments: object) -> None:
        calls.append(arguments)
        raise RuntimeError("the driver is broken")

    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setattr(mujoco, "Renderer", broken)
    renderer = CellRenderer(simulation, 64, 48)
    with caplog.at_level(logging.INFO):
        assert renderer.picture().shape == renderer.picture().shape == (48, 64, 3)
    assert len(calls) == 1
    assert "no OpenGL (the driver is broken)" in caplog.text


def test_gl_is_used_where_it_works(simulation: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for MuJoCo's renderer: it is asked for the painter's own view."""
    seen = []
    stand_in = SimpleNamespace(
        update_scene=lambda data, camera: seen.append(camera),
        render=lambda: np.full((48, 64, 3), 7, np.uint8),
        close=lambda: seen.append("closed"),
    )
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setattr(mujoco, "Renderer", lambda *_: stand_in)
    renderer = CellRenderer(simulation, 64, 48)
    assert (renderer.picture() == 7).all()
    renderer.close()
    camera, closed = seen
    assert closed == "closed"
    azimuth, elevation = np.radians([camera.azimuth, camera.elevation])
    forward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    T_world_cam = default_viewpoint(simulation)
    np.testing.assert_allclose(forward, T_world_cam[:3, 2], atol=1e-9)
    np.testing.assert_allclose(camera.lookat - camera.distance * forward, T_world_cam[:3, 3], atol=1e-9)


def test_without_a_display_the_viewer_says_so(simulation: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(RuntimeError, match="render_mode='human' needs a display, and none is set; 'rgb_array' needs"):
        CellRenderer(simulation).show()


def test_the_viewer_is_opened_once_and_closed(simulation: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []

    def launch_passive(model: mujoco.MjModel, data: mujoco.MjData) -> SimpleNamespace:
        assert model is simulation.model
        assert data is simulation.data
        calls.append("launch")
        return SimpleNamespace(sync=lambda: calls.append("sync"), close=lambda: calls.append("close"))

    viewer = SimpleNamespace(launch_passive=launch_passive)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setitem(sys.modules, "mujoco.viewer", viewer)
    monkeypatch.setattr(mujoco, "viewer", viewer, raising=False)
    renderer = CellRenderer(simulation)
    renderer.show()
    renderer.show()
    renderer.close()
    renderer.close()
    assert calls == ["launch", "sync", "sync", "close"]
