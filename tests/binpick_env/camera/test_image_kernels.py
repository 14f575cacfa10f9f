"""Kernels over images against their plain twins: the same bits."""

import numpy as np
import pytest

from binpick_env.camera import _occlusion_kernels
from binpick_env.camera._image_kernels import instances_at
from binpick_env.camera._sensor_kernels import projector_shadow
from binpick_env.camera.sensor import SensorModel
from binpick_env.camera.shading import FACET, STEP, Light
from tests.binpick_env.camera.random_images import random_image
from tests.reference import occlusion_twin, sensor_twin

SENSORS = (
    SensorModel(sigma_z=0.001, edge_loss=0.3, max_incidence=np.deg2rad(65.0), baseline=0.15),
    SensorModel(sigma_z=0.001, edge_loss=1.0, edge_jump=0.0005, baseline=-0.1),
    SensorModel(sigma_z=0.0003, max_incidence=np.deg2rad(50.0)),
)


@pytest.mark.parametrize("seed", range(12))
def test_ambient_occlusion_is_that_of_eight_sweeps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth, normals, K = random_image(rng)
    radius = rng.choice([0.002, 0.01, 0.05])
    found = _occlusion_kernels.ambient_occlusion(depth, normals, K, radius, FACET, STEP)
    np.testing.assert_array_equal(found, occlusion_twin.ambient_occlusion(depth, normals, K, radius, FACET, STEP))


def test_some_of_the_random_images_are_occluded() -> None:
    images = [random_image(np.random.default_rng(seed)) for seed in range(12)]
    shares = [np.mean(_occlusion_kernels.ambient_occlusion(*image, 0.01, FACET, STEP) > 0) for image in images]
    assert sum(0.05 < share < 0.95 for share in shares) >= 6


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("seed", range(6))
def test_the_sensor_measures_what_plain_loops_measure(seed: int, sensor: SensorModel) -> None:
    depth, normals, K = random_image(np.random.default_rng(seed))
    rng, drawn = np.random.default_rng(seed), np.random.default_rng(seed)
    found = sensor.apply(depth, normals, K, rng)
    draws = drawn.standard_normal(depth.shape, dtype=np.float32), drawn.random(depth.shape, dtype=np.float32)
    np.testing.assert_array_equal(found, sensor_twin.measure(depth, normals, K, draws, sensor))
    assert rng.random() == drawn.random()  # and no other number was drawn


def test_an_image_of_more_rows_than_are_measured_at_once() -> None:
    rng = np.random.default_rng(0)
    depth = rng.choice([0.8, 0.9], (200, 7)).astype(np.float32)
    normals = np.broadcast_to(np.float32([0, 0, -1]), (200, 7, 3)).copy()
    K = np.array([[600.0, 0, 3], [0, 600.0, 100], [0, 0, 1]])
    found = SENSORS[0].apply(depth, normals, K, np.random.default_rng(1))
    drawn = np.random.default_rng(1)
    draws = drawn.standard_normal(depth.shape, dtype=np.float32), drawn.random(depth.shape, dtype=np.float32)
    np.testing.assert_array_equal(found, sensor_twin.measure(depth, normals, K, draws, SENSORS[0]))


@pytest.mark.parametrize("baseline", [0.15, -0.15])
def test_the_projector_s_shadow_is_that_of_plain_loops(baseline: float) -> None:
    for seed in range(6):
        depth, _, K = random_image(np.random.default_rng(seed))
        expected = sensor_twin.projector_shadow(depth, K, baseline)
        np.testing.assert_array_equal(projector_shadow(depth, K, baseline), expected)


@pytest.mark.parametrize("seed", range(6))
def test_the_grey_image_follows_the_formula(seed: int) -> None:
    depth, normals, K = random_image(np.random.default_rng(seed))
    ids = np.random.default_rng(seed).integers(-1, 2, depth.shape)
    light = Light(background=9)
    occluded = occlusion_twin.ambient_occlusion(depth, normals, K, light.radius, FACET, STEP).astype(np.float64)
    to_light = np.array(light.to_light) / np.linalg.norm(light.to_light)
    n, z = normals.astype(np.float64), np.where(depth > 0, depth, np.inf).astype(np.float64)
    facing = n[..., 0] * to_light[0] + n[..., 1] * to_light[1] + n[..., 2] * to_light[2]
    intensity = (light.ambient + light.diffuse * np.maximum(facing, 0)) * (1 - light.occlusion * occluded)
    intensity *= 1 + light.falloff * ((light.reference / z) * (light.reference / z) - 1)
    albedo = np.where(ids >= 0, np.float32(light.part_albedo), np.float32(light.container_albedo)).astype(np.float64)
    grey = np.clip(255 * albedo * intensity + 0.5, 0, 255).astype(np.uint8)
    np.testing.assert_array_equal(light.shade(depth, normals, ids, K), np.where(depth > 0, grey, 9))


def test_the_parts_of_geoms_are_those_of_numpy_s_index() -> None:
    geom_at = np.random.default_rng(0).integers(-1, 5, (9, 11)).astype(np.int32)
    instances = np.array([-1, 3, -1, 0, 1, -1])
    np.testing.assert_array_equal(instances_at(geom_at, instances), instances[geom_at])
