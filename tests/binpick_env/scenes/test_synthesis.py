"""Scenes agree with their ground truth, and depend on their configuration and index alone."""

import json
import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from binpick_env.camera.depth_camera import DepthCamera, default_pose
from binpick_env.camera.shading import Light
from binpick_env.config import BinConfig, CameraConfig, SensorChoice
from binpick_env.part_limits import FILLING
from binpick_env.parts import load_part
from binpick_env.parts.families.names import training_parts
from binpick_env.scenes import synthesis
from binpick_env.scenes.synthesis import (
    FULL_MIXTURE,
    MANY_PARTS,
    MIXTURE,
    SCENES_PER_PART,
    SceneConfig,
    draw_light,
    ensure_folder_config,
    generate_scenes,
    is_of_part,
    make_scene,
    scene_path,
    scene_settings,
)
from perception.boundary import organised_points
from perception.geometry import invert_transform, project_points, transform_points
from perception.segmentation.scene import BoundaryScene
from tests.binpick_env.jobs.pickled_map import pickled_map

CAMERA = CameraConfig(width=320, height=240, backend="raster")
TINY = SceneConfig(part="part_c", num_parts=(2, 4), sensor="none", camera=CAMERA)
WORKSPACE = BinConfig().workspace()


@pytest.fixture(scope="module")
def captured() -> list[synthesis.CapturedScene]:
    return [make_scene(TINY, index) for index in range(4)]


def content(scene: BoundaryScene) -> list[np.ndarray]:
    """Return every array of a scene."""
    cloud = scene.boundary
    return [
        cloud.points_cam, cloud.tangents_cam, cloud.linearity, cloud.pixels, scene.surface.depth, scene.K,
        scene.instance_ids, scene.T_cam_parts, scene.centres_cam, scene.visible_fractions,
    ]  # fmt: skip


def same(one: BoundaryScene, other: BoundaryScene) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(content(one), content(other), strict=True))


# --- truth -----------------------------------------------------------------------------------------------------------


def test_labelled_points_lie_on_their_parts(captured: list[synthesis.CapturedScene]) -> None:
    mesh = load_part("part_c").model.mesh
    rng = np.random.default_rng(0)
    for scene, _ in captured[:3]:
        assert scene.instance_ids.max() < len(scene.T_cam_parts)
        for i in np.unique(scene.instance_ids[scene.instance_ids >= 0]):
            mine = np.nonzero(scene.instance_ids == i)[0]
            some = rng.choice(mine, min(20, len(mine)), replace=False)
            points_part = transform_points(invert_transform(scene.T_cam_parts[i]), scene.boundary.points_cam[some])
            _, distance, _ = trimesh.proximity.closest_point_naive(mesh, points_part)
            assert distance.max() < 1e-5


def test_centres_are_the_parts_own(captured: list[synthesis.CapturedScene]) -> None:
    model = load_part("part_c").model
    for scene, _ in captured:
        assert scene.part == "part_c"
        assert scene.d_max == model.d_max
        for T_cam_part, centre_cam in zip(scene.T_cam_parts, scene.centres_cam, strict=True):
            np.testing.assert_allclose(centre_cam, (T_cam_part @ np.append(model.centre, 1.0))[:3])
        reach = np.linalg.norm(scene.boundary.points_cam - scene.centres_cam[scene.instance_ids], axis=1)
        assert reach[scene.instance_ids >= 0].max() < 0.75 * model.d_max


def test_a_scene_is_what_its_frame_shows(captured: list[synthesis.CapturedScene]) -> None:
    for scene, capture in captured:
        u, v = scene.boundary.pixels.T
        np.testing.assert_array_equal(scene.instance_ids, capture.instance_ids[v, u])
        points_cam = organised_points(capture.frame, scene.boundary.pixels)
        np.testing.assert_array_equal(scene.boundary.points_cam, points_cam)
        assert 2 <= len(scene.T_cam_parts) <= 4
        assert scene.visible_fractions.min() >= 0.0
        assert scene.visible_fractions.max() <= 1.0
        seen = np.bincount(capture.instance_ids[capture.instance_ids >= 0], minlength=len(scene.T_cam_parts))
        np.testing.assert_array_equal(scene.visible_fractions > 0, seen > 0)
        assert (scene.instance_ids >= 0).mean() > 0.95  # container and table are taken out


def test_the_focal_length_goes_with_the_image(captured: list[synthesis.CapturedScene]) -> None:
    (small, _), *_ = captured
    np.testing.assert_allclose(small.K[[0, 1], [0, 1]], 600.0)
    large, _ = make_scene(replace(TINY, camera=CameraConfig(width=640, height=480)), 0)
    np.testing.assert_allclose(large.K[[0, 1], [0, 1]], 1200.0)
    np.testing.assert_array_equal(large.T_cam_parts, small.T_cam_parts)
    low, high = large.boundary.points_cam.min(axis=0), large.boundary.points_cam.max(axis=0)
    np.testing.assert_allclose(small.boundary.points_cam.min(axis=0), low, atol=0.006)
    np.testing.assert_allclose(small.boundary.points_cam.max(axis=0), high, atol=0.006)


# --- chance ----------------------------------------------------------------------------------------------------------


def test_a_scene_depends_on_its_index_alone(captured: list[synthesis.CapturedScene]) -> None:
    make_scene(replace(TINY, part="part_a"), 0)  # another setup
    for index in (2, 0):
        assert same(make_scene(TINY, index).scene, captured[index].scene)
    poses = [scene.T_cam_parts for scene, _ in captured]
    assert len({pose.tobytes() for pose in poses}) == len(poses)
    assert not same(make_scene(replace(TINY, seed=1), 0).scene, captured[0].scene)
    assert len({len(pose) for pose in poses}) > 1


def test_the_files_do_not_depend_on_the_workers(
    tmp_path: Path, captured: list[synthesis.CapturedScene], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Processes are started in the evaluation of poses."""
    alone, many = tmp_path / "1", tmp_path / "2"
    assert list(generate_scenes(TINY, 2, alone, 1)) == [0, 1]
    monkeypatch.setattr(synthesis, "map_indices", pickled_map)
    assert list(generate_scenes(TINY, 2, many, 2)) == [1, 0]
    for index in range(2):
        assert scene_path(alone, index).read_bytes() == scene_path(many, index).read_bytes()
        points_cam = BoundaryScene.load(scene_path(many, index)).boundary.points_cam
        np.testing.assert_array_equal(points_cam, captured[index].scene.boundary.points_cam)


def test_jitter_moves_the_camera_within_bounds(captured: list[synthesis.CapturedScene]) -> None:
    poses = [capture.frame.T_world_cam for _, capture in captured]
    assert len({pose.tobytes() for pose in poses}) == len(poses)
    T_nominal = default_pose(WORKSPACE, CAMERA.distance)
    setup = synthesis._scene_setup(TINY)
    poses += [synthesis._draw_pose(setup.camera, np.random.default_rng(seed)) for seed in range(200)]
    corners_bin = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (0, 2)]) * WORKSPACE.inner_size / 2
    corners_world = transform_points(WORKSPACE.T_world_bin, corners_bin)
    tilts, distances = [], []
    for pose in poses:
        np.testing.assert_allclose(np.linalg.det(pose[:3, :3]), 1.0)
        tilts.append(np.arccos(np.clip(pose[:3, 2] @ T_nominal[:3, 2], -1, 1)))
        distances.append(np.linalg.norm(pose[:3, 3] - WORKSPACE.T_world_bin[:3, 3]))
        pixels = project_points(setup.camera.K, transform_points(invert_transform(pose), corners_world))
        assert pixels.min() >= 0.0
        assert (pixels < (CAMERA.width, CAMERA.height)).all()
    assert max(tilts) <= np.deg2rad(4.0) + 1e-6
    assert max(tilts) > np.deg2rad(3.5)
    assert min(distances) > 0.845
    assert max(distances) < 0.955
    assert np.ptp(distances) > 0.08
    directions = np.array([T_nominal[:3, :2].T @ pose[:3, 2] for pose in poses])  # to which side the camera is tilted
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert np.abs(directions.mean(axis=0)).max() < 0.2


def test_without_jitter_camera_and_light_are_the_cells_own(monkeypatch: pytest.MonkeyPatch) -> None:
    lights: list[Light | None] = []
    capture_with = DepthCamera.capture

    def spy(self: DepthCamera, data: Any, rng: Any, sensor: Any, light: Light | None, *more: Any) -> Any:
        lights.append(light)
        return capture_with(self, data, rng, sensor, light, *more)

    monkeypatch.setattr(DepthCamera, "capture", spy)
    for index in (0, 1):
        _, capture = make_scene(replace(TINY, jitter=False), index)
        np.testing.assert_array_equal(capture.frame.T_world_cam, default_pose(WORKSPACE, CAMERA.distance))
    assert lights == [None, None]
    make_scene(TINY, 0)
    make_scene(TINY, 1)
    assert lights[2] is not None
    assert lights[2] != lights[3]


def test_light_comes_from_within_45_degrees_of_the_cameras_axis() -> None:
    rng = np.random.default_rng(0)
    lights = [draw_light(rng) for _ in range(300)]
    directions = np.array([light.to_light for light in lights])
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    angle = np.rad2deg(np.arccos(-directions[:, 2]))
    assert 43 < angle.max() <= 45.0 + 1e-9
    assert np.abs(directions[:, :2].mean(axis=0)).max() < 0.08  # from all sides
    assert all(light.ambient + light.diffuse == pytest.approx(1.0) for light in lights)
    assert all(light.part_albedo >= light.container_albedo for light in lights)


@pytest.mark.parametrize(("choice", "mixture"), [("mixed", MIXTURE), ("all", FULL_MIXTURE)])
def test_a_mixture_draws_every_preset_in_its_share(choice: SensorChoice, mixture: dict[str, float]) -> None:
    rng = np.random.default_rng(0)
    drawn = [synthesis._draw_sensor(choice, rng) for _ in range(3000)]
    assert sum(mixture.values()) == pytest.approx(1.0)
    for name, share in mixture.items():
        assert drawn.count(name) / 3000 == pytest.approx(share, abs=0.03)


def test_a_mixed_scene_is_seen_by_the_preset_drawn_for_it() -> None:
    kinds = set()
    for index in range(12):
        _, capture = make_scene(replace(TINY, sensor="mixed"), index)
        both = capture.frame.valid & (capture.depth_true > 0)
        noise = 1000 * np.std(capture.frame.depth[both] - capture.depth_true[both])
        kinds.add("none" if noise == 0 else "good" if noise < 0.5 else "harsh")
    assert kinds == set(MIXTURE)


# --- files -----------------------------------------------------------------------------------------------------------


def test_a_run_is_resumed_and_damaged_files_are_made_again(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert list(generate_scenes(TINY, 2, tmp_path)) == [0, 1]
    whole = [scene_path(tmp_path, index).read_bytes() for index in range(2)]
    kept = scene_path(tmp_path, 0).stat().st_mtime_ns
    scene_path(tmp_path, 1).write_bytes(whole[1][: len(whole[1]) // 2])
    with caplog.at_level(logging.WARNING):
        assert list(generate_scenes(TINY, 3, tmp_path)) == [0, 1, 2]
    assert "made again: " in caplog.text
    assert "scene_00001.npz does not hold a complete scene" in caplog.text
    assert scene_path(tmp_path, 0).stat().st_mtime_ns == kept
    assert scene_path(tmp_path, 1).read_bytes() == whole[1]
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "scene_00000.npz", "scene_00001.npz", "scene_00002.npz", "scenes.json",
    ]  # fmt: skip


def test_a_stop_keeps_what_is_finished(tmp_path: Path) -> None:
    scenes = generate_scenes(TINY, 5, tmp_path)
    assert next(scenes) == 0
    scenes.close()  # type: ignore[attr-defined]
    assert [path.name for path in tmp_path.glob("scene_*")] == ["scene_00000.npz"]


def test_another_configuration_in_the_folder_is_refused(tmp_path: Path) -> None:
    ensure_folder_config(TINY, tmp_path)
    ensure_folder_config(TINY, tmp_path)
    other = replace(TINY, seed=3, sensor="good", num_parts=(2, 5))
    text = (
        r"holds scenes of another configuration \(num_parts: \[2, 4\] there, \[2, 5\] here, seed: 0 there, 3 here, "
        r"sensor: none there, good here\); choose another folder with --out, or delete this one"
    )
    with pytest.raises(ValueError, match=text):
        next(generate_scenes(other, 1, tmp_path))


def test_a_folder_of_the_previous_version_is_resumed(tmp_path: Path) -> None:
    """Settings as version 0.1.0 wrote them (commit 3e3d809), which knew no symmetry, density, bin and friction."""
    optics = {"width": 1280, "height": 960, "focal": 2400.0, "distance": 0.9, "hand_eye": 0.0, "backend": "raster"}
    written = {"part": "part_b", "unit": None, "seed": 3, "num_parts": [2, 3], "sensor": "good", "jitter": True}
    written["camera"] = optics
    (tmp_path / "scenes.json").write_text(json.dumps(written))
    config = SceneConfig(part="part_b", seed=3, num_parts=(2, 3))
    assert synthesis.scene_settings(config) == written
    ensure_folder_config(config, tmp_path)
    with pytest.raises(ValueError, match=r"another configuration \(friction: None there, 0.3 here\)"):
        ensure_folder_config(replace(config, friction=0.3), tmp_path)


def test_part_and_bin_are_those_of_the_configuration() -> None:
    config = replace(TINY, part="tee", bin=(0.3, 0.2, 0.1), friction=0.3, density=1000.0)
    setup = synthesis._scene_setup(config)
    assert setup.camera.workspace.inner_size.tolist() == [0.3, 0.2, 0.1]
    assert setup.part.density == 1000.0
    friction = setup.simulation.model.geom_friction[:, 0]
    assert np.count_nonzero(friction == 0.3) > 5
    assert 0.5 not in friction


def test_many_parts_follow_each_other_and_fill_the_bin_by_their_size() -> None:
    many = SceneConfig(part=MANY_PARTS, num_parts=(5, 40), camera=CAMERA)
    names = [many.at(k * SCENES_PER_PART).part for k in range(6)]
    assert names == training_parts(6)
    assert many.at(SCENES_PER_PART - 1) == many.at(0)
    for k in (0, 4):  # a long shaft, and a spool of 186 mm
        config = many.at(k * SCENES_PER_PART)
        low, high = config.num_parts
        hull = load_part(config.part).model.mesh.convex_hull.volume
        assert high * hull <= FILLING * np.prod(BinConfig().inner_size) < (high + 1) * hull
        assert low == min(5, high)
    assert many.at(7 * SCENES_PER_PART).num_parts == (5, 40)


def test_a_scene_of_many_parts_is_that_of_its_part_and_index() -> None:
    many = SceneConfig(part=MANY_PARTS, num_parts=(2, 3), camera=CAMERA)
    index = 5 * SCENES_PER_PART + 1
    scene, direct = (make_scene(config, index).scene for config in (many, many.at(index)))
    assert scene.part.startswith("generated:pulley")
    assert same(scene, direct)


def test_stored_scenes_are_of_a_part_by_its_files_content_or_name(tmp_path: Path) -> None:
    paths = [tmp_path / folder / "lid.stl" for folder in ("a", "b")]
    for path, content in zip(paths, ("one", "two"), strict=True):
        path.parent.mkdir()
        path.write_text(content)
    first, second = (SceneConfig(part=str(path)) for path in paths)
    stored = scene_settings(first)
    assert is_of_part(stored, first)
    assert not is_of_part(stored, second)  # another part of that name
    assert is_of_part({**stored, "part": "elsewhere/cover.stl"}, first)  # the file was moved and renamed
    assert is_of_part({"part": "elsewhere/lid.stl"}, second)  # an older folder tells the name alone
    many = scene_settings(SceneConfig(part=MANY_PARTS))
    assert is_of_part(many, SceneConfig(part="generated:clevis:3"))
    assert not is_of_part(many, SceneConfig(part="tee"))


@pytest.mark.parametrize("damage", ["{", "[]", "3", ""])
def test_a_damaged_configuration_file_is_refused(tmp_path: Path, damage: str) -> None:
    (tmp_path / "scenes.json").write_text(damage)
    with pytest.raises(ValueError, match=r"scenes\.json is damaged; choose another folder with --out, or delete this"):
        ensure_folder_config(TINY, tmp_path)


def test_a_changed_part_file_is_another_configuration(tmp_path: Path) -> None:
    path = tmp_path / "block.stl"
    config = replace(TINY, part=str(path))
    trimesh.creation.box((0.06, 0.04, 0.03)).export(path)
    ensure_folder_config(config, tmp_path / "scenes")
    ensure_folder_config(config, tmp_path / "scenes")
    trimesh.creation.box((0.05, 0.04, 0.03)).export(path)
    with pytest.raises(ValueError, match=r"another configuration .file: [0-9a-f]{64} there, [0-9a-f]{64} here.;"):
        ensure_folder_config(config, tmp_path / "scenes")


def test_a_part_that_does_not_exist_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="part must be one of part_a"):
        next(generate_scenes(replace(TINY, part="teapot"), 1, tmp_path / "out"))
    with pytest.raises(FileNotFoundError, match=r"nowhere\.stl"):
        next(generate_scenes(replace(TINY, part="nowhere.stl"), 1, tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_an_empty_bin_is_a_scene(tmp_path: Path) -> None:
    config = replace(TINY, num_parts=(0, 0))
    assert list(generate_scenes(config, 1, tmp_path)) == [0]
    scene = BoundaryScene.load(scene_path(tmp_path, 0))
    assert scene.T_cam_parts.shape == (0, 4, 4)
    assert len(scene.boundary) == 0
    assert (scene.surface.depth > 0).mean() > 0.9


# --- nonsense --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"num_parts": (5, 4)}, r"num_parts must be \(smallest, largest\) from 0 up, got \(5, 4\)"),
        ({"num_parts": (-1, 4)}, r"num_parts must be \(smallest, largest\) from 0 up, got \(-1, 4\)"),
        ({"seed": -1}, "seed must not be negative, got -1"),
        ({"bin": (0.3, 0.2, -0.1)}, "bin must be length, width and height inside"),
        ({"friction": 5.0}, "friction must be from 0 to 2, got 5.0"),
        ({"sensor": "foul"}, "sensor must be one of none, good, harsh, stereo, tof, mixed, all, got 'foul'"),
    ],
)
def test_nonsense_in_the_configuration_is_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        replace(TINY, **changes)


@pytest.mark.parametrize(("count", "workers"), [(0, 1), (1, 0), (-1, 2)])
def test_nothing_to_make_is_refused(tmp_path: Path, count: int, workers: int) -> None:
    with pytest.raises(ValueError, match=f"count and workers must be at least 1, got {count} and {workers}"):
        next(generate_scenes(TINY, count, tmp_path, workers))


def test_a_varied_scene_of_all_sensors_is_labelled_and_only_a_varied_one_is_noted() -> None:
    config = replace(TINY, sensor="all", appearance="varied")
    scene, capture = make_scene(config, 0)
    u, v = scene.boundary.pixels.T
    np.testing.assert_array_equal(scene.instance_ids, capture.instance_ids[v, u])
    assert same(scene, make_scene(config, 0).scene)
    assert synthesis.scene_settings(config)["appearance"] == "varied"
    assert "appearance" not in synthesis.scene_settings(TINY)
    with pytest.raises(ValueError, match="appearance must be clean or varied, got 'dirty'"):
        replace(TINY, appearance="dirty")  # type: ignore[arg-type]
