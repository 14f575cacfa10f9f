"""Shapes, segments and points in a recording."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
import trimesh

from binpick_env.camera.view import visible_geoms
from binpick_env.config import CameraConfig
from binpick_env.evaluation.segmentation.pictures import part_colours
from perception.geometry import make_transform, transform_points
from policies.evaluation.watched_env import WatchedEnv
from policies.report import recording_scene
from policies.report.recording_motion import instance_poses, pack
from policies.report.recording_scene import SceneLog, geom_mesh, is_whole, shaded_mesh
from tests.last_frame import change_depth, change_frame
from tests.policies.fake_cell import observed
from tests.policies.report.rrd_file import RrdFile
from tests.shared_models import share_shaded_meshes


@pytest.fixture(autouse=True, scope="module")
def _meshes_are_shared() -> None:
    share_shaded_meshes()


@pytest.fixture(scope="module")
def cell() -> Iterator[WatchedEnv]:
    """The cell with one part."""
    camera = CameraConfig(width=320, height=240)
    env = WatchedEnv("part_c", num_parts=1, perception="oracle", camera=camera, threads=1)
    yield env
    env.close()


@pytest.fixture
def env(cell: WatchedEnv) -> WatchedEnv:
    """The cell with a settled part and its first frame, which a test may change."""
    cell.reset(seed=3)
    return cell


def write(env: WatchedEnv, path: Path) -> RrdFile:
    log = SceneLog(path, env)
    log.frame(0)
    log.close()
    return RrdFile(path)


def corners(mesh: Any) -> Any:
    """Return the (T, 3, 3) corners of a Rerun mesh."""
    vertices = np.array(mesh.vertex_positions.as_arrow_array().to_pylist(), np.float64)
    return vertices[np.array(mesh.triangle_indices.as_arrow_array().to_pylist())]


def normals(mesh: Any) -> Any:
    return np.array(mesh.vertex_normals.as_arrow_array().to_pylist(), np.float64)


def test_a_box_keeps_its_edges_and_a_cylinder_is_smooth() -> None:
    box = trimesh.creation.box((0.2, 0.1, 0.3))
    mesh = shaded_mesh(np.asarray(box.vertices), np.asarray(box.faces, np.int32), (1, 2, 3))
    np.testing.assert_allclose(corners(mesh), box.triangles, atol=1e-7)
    assert len(normals(mesh)) == 24  # a corner in each of three faces
    np.testing.assert_allclose(np.abs(normals(mesh)).max(axis=1), 1.0)
    cylinder = trimesh.creation.cylinder(0.1, 0.3, sections=24)
    mesh = shaded_mesh(np.asarray(cylinder.vertices), np.asarray(cylinder.faces, np.int32), (1, 2, 3))
    assert len(normals(mesh)) == 4 * 24 + 2  # a rim belongs to a cap and to the side; caps have their middle
    np.testing.assert_allclose(corners(mesh), cylinder.triangles, atol=1e-7)


def test_vertices_at_the_same_position_are_merged() -> None:
    soup = trimesh.creation.icosphere(subdivisions=2)
    faces = np.arange(3 * len(soup.faces), dtype=np.int32).reshape(-1, 3)
    mesh = shaded_mesh(np.asarray(soup.triangles).reshape(-1, 3), faces, (1, 2, 3))
    assert len(normals(mesh)) == len(soup.vertices)
    np.testing.assert_allclose(normals(mesh), np.array(mesh.vertex_positions.as_arrow_array().to_pylist()), atol=0.03)


def test_geoms_are_where_the_simulation_has_them(env: WatchedEnv) -> None:
    model, data = env.simulation.model, env.simulation.data
    some = [g for g in visible_geoms(model) if env.simulation.part_of_geom[g] < 0]
    for geom in (model.geom("bin/wall_x+").id, *some[2:10:3], some[20]):
        body = model.geom_bodyid[geom]
        T_world_body = make_transform(data.xmat[body].reshape(3, 3), data.xpos[body])
        found = transform_points(T_world_body, corners(geom_mesh(model, geom)).reshape(-1, 3))
        mesh = model.geom_dataid[geom]
        if mesh >= 0:
            start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            known = model.mesh_vert[start : start + count].astype(np.float64)
        else:
            known = np.array([-1, 1])[:, None] * model.geom_size[geom]
        T_world_geom = make_transform(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom])
        true = transform_points(T_world_geom, known)
        if mesh >= 0:
            np.testing.assert_allclose(found.min(axis=0), true.min(axis=0), atol=1e-5)
        np.testing.assert_allclose(np.ptp(found, axis=0).max(), np.ptp(true, axis=0).max(), atol=1e-5)


def test_without_parts_one_instance_of_scale_zero_is_drawn() -> None:
    positions, quaternions, scales = instance_poses(pack(np.zeros((0, 4, 4))))
    assert positions.shape == (1, 3)
    np.testing.assert_array_equal(quaternions, [[0, 0, 0, 1]])
    np.testing.assert_array_equal(scales, np.zeros((1, 3)))
    T = make_transform(np.diag([-1.0, 1, -1]), (1, 2, 3))[None]  # half a turn about y
    positions, quaternions, scales = instance_poses(pack(T))
    np.testing.assert_allclose(positions, [[1, 2, 3]])
    np.testing.assert_allclose(np.abs(quaternions), [[0, 1, 0, 0]], atol=1e-12)
    np.testing.assert_array_equal(scales, np.ones((1, 3)))


@pytest.mark.slow
def test_a_truncated_file_is_not_complete(env: WatchedEnv, tmp_path: Path) -> None:
    path = tmp_path / "bin.rrd"
    write(env, path)
    assert is_whole(path)
    log = SceneLog(path, env)
    log.frame(0)
    log._stream.disconnect()
    path.write_bytes(path.read_bytes()[:-1000])
    assert not is_whole(path)
    log._stream = rr.RecordingStream("elsewhere")  # as if nothing more had come to the disk
    with pytest.raises(OSError, match="could not be written to its end; is the disk full"):
        log.close()
    assert not is_whole(tmp_path / "nowhere.rrd")


def test_boundary_points_have_the_colours_of_their_segments(env: WatchedEnv, tmp_path: Path) -> None:
    observation = observed(env.labelled_capture, [list(range(50)), list(range(60, 100))], env.candidates, of=[0])
    points_cam = np.column_stack([np.linspace(-0.1, 0.1, 320), np.zeros(320), np.full(320, 0.8)])
    assert observation.perception is not None
    boundary = replace(observation.perception.boundary, points_cam=points_cam)
    change_frame(env, observed=replace(observation, perception=replace(observation.perception, boundary=boundary)))
    file = write(env, tmp_path / "bin.rrd")
    (_, colours), (_, points) = (
        file.rows("/world/seen/segments", f"Points3D:{name}")[0] for name in ("colors", "positions")
    )
    np.testing.assert_allclose(points, transform_points(env.frame.T_world_cam, points_cam), atol=1e-6)
    rgb = np.array(colours, np.int64)[:, None] >> np.array([24, 16, 8]) & 255
    first, second = part_colours(2)[:, ::-1]
    np.testing.assert_array_equal(rgb[:50], np.tile(first, (50, 1)))
    np.testing.assert_array_equal(rgb[60:100], np.tile(second, (40, 1)))
    assert len(np.unique(rgb[100:], axis=0)) == 1
    assert np.ptp(rgb[100]) == 0  # grey
    np.testing.assert_array_equal(rgb[50:60], rgb[100:110])


def test_a_cloud_is_thinned_and_a_frame_without_depth_has_none(
    env: WatchedEnv, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    most = 20_000
    monkeypatch.setattr(recording_scene, "CLOUD_POINTS", most)
    assert env.frame.valid.sum() > 2 * most
    (_, points) = write(env, tmp_path / "full.rrd").rows("/world/seen/cloud", "Points3D:positions")[0]
    assert most / 4 < len(points) <= most
    change_depth(env, 0.0)
    (_, points) = write(env, tmp_path / "empty.rrd").rows("/world/seen/cloud", "Points3D:positions")[0]
    assert points == []
