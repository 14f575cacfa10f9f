"""Normals and the grey image."""

from dataclasses import replace

import numpy as np
import trimesh

from binpick_env.camera.raster import corner_normals, is_closed
from binpick_env.camera.shading import Light
from perception.geometry import (
    deproject_depth,
    make_transform,
    rotation_about,
)
from tests.binpick_env.camera.camera_scene import Scene, build
from tests.binpick_env.camera.camera_views import WORKSPACE, look


def test_a_faceted_cylinder_is_shaded_round_and_keeps_its_rim(backend: str) -> None:
    cylinder = trimesh.creation.cylinder(radius=0.02, height=0.08, sections=32)
    lying, standing = rotation_about((1, 0, 0), np.pi / 2), np.eye(3)
    T = [make_transform(R, (x, 0, 0.04)) for R, x in ((lying, -0.05), (standing, 0.05))]
    capture = look(build(WORKSPACE.T_world_bin @ np.stack(T), cylinder), backend)
    points = deproject_depth(capture.frame.K, capture.depth_true)
    round_ = points[..., 0] + 0.05
    middle = (capture.instance_ids == 0) & (np.abs(points[..., 1]) < 0.03) & (np.abs(round_) < 0.018)
    wanted = np.arcsin(round_[middle] / 0.02)
    found = np.arctan2(capture.normals[middle][:, 0], -capture.normals[middle][:, 2])
    assert np.max(np.abs(found - wanted)) < np.deg2rad(1.0)  # a flat facet is off by up to 5.6 degrees
    cap = (capture.instance_ids == 1) & (capture.depth_true < 0.8201 + 1e-4)
    assert cap.sum() > 500
    assert np.mean(capture.normals[cap][:, 2] < -0.9999) > 0.98


def test_normals_are_unit_and_face_the_eye(pile: Scene, backend: str) -> None:
    capture = look(pile, backend)
    seen = capture.depth_true > 0
    np.testing.assert_allclose(np.linalg.norm(capture.normals[seen], axis=1), 1.0, atol=1e-5)
    rays = deproject_depth(capture.frame.K, capture.depth_true)
    assert np.mean(np.sum(rays * capture.normals, axis=-1)[seen] < 0) > 0.999
    assert np.all(capture.normals[~seen] == 0)


def test_corner_normals_of_a_box_are_its_faces_normals() -> None:
    box = trimesh.creation.box((1, 2, 3))
    normals = corner_normals(np.asarray(box.vertices), np.asarray(box.faces, np.int32))
    np.testing.assert_allclose(normals, np.repeat(box.face_normals[:, None], 3, axis=1), atol=1e-6)
    assert is_closed(np.asarray(box.faces, np.int32))
    assert not is_closed(np.asarray(box.faces[:-1], np.int32))


def plate_on_plate(light: Light) -> np.ndarray:
    """Return a grey row over the rim, at column 32, of a plate that lies 4 mm thick on another."""
    depth = np.full((64, 64), 0.9, np.float32)
    depth[:, :32] -= 0.004
    normals = np.zeros((64, 64, 3), np.float32)
    normals[..., 2] = -1
    K = np.array([[2400.0, 0, 32], [0, 2400.0, 32], [0, 0, 1]])
    return light.shade(depth, normals, np.zeros((64, 64), np.int64), K)[32].astype(int)


def test_occlusion_shows_the_rim_of_a_plate_on_a_plate() -> None:
    plain, occluded = plate_on_plate(Light(occlusion=0)), plate_on_plate(Light())
    assert abs(plain[31] - plain[32]) <= 2
    assert occluded[31] - occluded[32] > 25
    ramp = np.diff(occluded[32:50])
    assert np.all((ramp >= 0) & (ramp <= 6))  # fades without a second edge
    np.testing.assert_array_equal(occluded[:32], plain[:32])
    np.testing.assert_array_equal(occluded[50:], plain[50:])


def test_grey_of_a_plane_is_the_formula() -> None:
    light = Light(to_light=(0, 0, -2), ambient=0.1, diffuse=0.6, part_albedo=0.5, falloff=1.0)
    assert plate_on_plate(light)[60] == round(255 * 0.5 * 0.7)
    assert plate_on_plate(light)[5] == round(255 * 0.5 * 0.7 * (0.9 / 0.896) ** 2)
    assert plate_on_plate(replace(light, to_light=(0, 0, 1)))[60] == round(255 * 0.5 * 0.1)
