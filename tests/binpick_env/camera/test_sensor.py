"""The structured-light sensor: every figure of its presets, measured on planes and steps."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from binpick_env.camera.sensor import SensorModel, sensor_model
from perception.geometry import Floats, camera_matrix

K = camera_matrix(2400.0, 640, 480)
SIZE = (480, 640)
QUIET = SensorModel()


def plane(z: float, tilt: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return depth and normals of a plane through (0, 0, z), turned about the camera's y axis by ``tilt`` [rad]."""
    normal = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    x = (np.arange(SIZE[1]) - K[0, 2]) / K[0, 0]
    depth = np.broadcast_to(normal[2] * z / (normal[0] * x + normal[2]), SIZE)
    return depth.astype(np.float32), np.broadcast_to(normal, (*SIZE, 3)).astype(np.float32)


def step(near: float, far: float, *, high_first: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Return depth and normals of two planes that meet at column 320, the near one left if ``high_first``."""
    depth, normals = plane(far)
    depth = depth.copy()
    depth[:, :320] = near
    return (depth if high_first else depth[:, ::-1].copy()), normals


def measure(sensor: SensorModel, scene: tuple[np.ndarray, np.ndarray], seed: int = 0, K: Floats = K) -> np.ndarray:
    return sensor.apply(*scene, K, np.random.default_rng(seed))


def light(preset: str) -> SensorModel:
    """Return a preset of structured light."""
    model = sensor_model(preset)
    assert isinstance(model, SensorModel)
    return model


def noise_of(sensor: SensorModel, scene: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    measured = measure(sensor, scene)
    return (measured.astype(np.float64) - scene[0])[measured > 0]


def test_none_is_the_identity() -> None:
    scene = step(0.8, 0.9)
    rng = np.random.default_rng(0)
    measured = light("none").apply(*scene, K, rng)
    np.testing.assert_array_equal(measured, scene[0])
    assert measured is not scene[0]
    assert rng.random() == np.random.default_rng(0).random()  # nothing was drawn


@pytest.mark.slow
@pytest.mark.parametrize(("preset", "sigma"), [("good", 0.0003), ("harsh", 0.001)])
def test_sigma_at_the_reference(preset: str, sigma: float) -> None:
    noise = noise_of(light(preset), plane(0.9))
    assert noise.std() == pytest.approx(sigma, rel=0.02)
    assert abs(noise.mean()) < sigma * 0.01


@pytest.mark.parametrize("preset", ["good", "harsh"])
def test_sigma_grows_with_the_square_of_depth(preset: str) -> None:
    near, far = (noise_of(light(preset), plane(z)).std() for z in (0.6, 1.2))
    assert far / near == pytest.approx(4.0, rel=0.03)


def test_sigma_grows_with_grazing_angle() -> None:
    flat, tilted = plane(0.9), plane(0.9, np.deg2rad(60))  # 0.9 m away along the middle columns
    middle = np.s_[:, 312:328]
    sigmas = [(measure(light("good"), scene) - scene[0])[middle].std() for scene in (flat, tilted)]
    assert sigmas[1] / sigmas[0] == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize(("preset", "limit_deg"), [("good", 75), ("harsh", 65)])
def test_nothing_returns_beyond_the_incidence(preset: str, limit_deg: float) -> None:
    sensor = replace(light(preset), baseline=0.0)
    x = (np.arange(SIZE[1]) - K[0, 2]) / K[0, 0]
    scene = plane(0.9, np.deg2rad(limit_deg))
    normal = scene[1][0, 0].astype(np.float64)
    incidence = np.arccos(-(normal[0] * x + normal[2]) / np.sqrt(x**2 + 1))  # in row 240; the others are steeper
    valid = measure(sensor, scene)[240] > 0
    np.testing.assert_array_equal(valid, incidence < np.deg2rad(limit_deg) - 1e-7)
    assert 0.2 < valid.mean() < 0.8
    assert not np.any(measure(sensor, plane(0.9, -np.deg2rad(limit_deg + 9))))


@pytest.mark.slow
@pytest.mark.parametrize(("preset", "share"), [("good", 0.02), ("harsh", 0.10)])
def test_share_of_lost_edge_pixels(preset: str, share: float) -> None:
    sensor = replace(light(preset), baseline=0.0)
    lost = np.stack([measure(sensor, step(0.8, 0.9), seed) == 0 for seed in range(40)])
    beside = lost[:, :, 319:321]  # the last near and the first far column
    assert beside.mean() == pytest.approx(share, rel=0.12)
    assert lost.sum() == beside.sum()


def test_a_steep_plane_has_no_edges_and_a_missing_neighbour_makes_one() -> None:
    sensor = replace(QUIET, edge_loss=1.0, edge_jump=0.001)
    steep = plane(0.9, np.deg2rad(74))
    assert np.abs(np.diff(steep[0], axis=1)).max() > 0.001
    assert np.all(measure(sensor, steep) > 0)
    holed = plane(0.9)[0].copy()
    holed[100, 200] = 0
    lost = measure(sensor, (holed, plane(0.9)[1])) == 0
    assert {tuple(p) for p in np.argwhere(lost)} == {(100, 200), (99, 200), (101, 200), (100, 199), (100, 201)}


@pytest.mark.parametrize("baseline", [0.12, 0.2])
def test_shadow_is_as_wide_as_the_two_disparities_differ(baseline: float) -> None:
    near, far = 0.85, 0.9
    width = K[0, 0] * baseline * (1 / near - 1 / far)  # light and camera rays through the step's edge, at the far plane
    right = measure(replace(QUIET, baseline=baseline), step(near, far, high_first=False))
    left = measure(replace(QUIET, baseline=-baseline), step(near, far))
    assert np.all((right == 0).sum(axis=1) == pytest.approx(width, abs=1.0))
    assert np.all(right[:, : 320 - int(np.ceil(width))] > 0)
    assert np.all(right[:, 320:] > 0)
    np.testing.assert_array_equal(left, right[:, ::-1])


def test_no_shadow_on_the_projectors_side() -> None:
    assert np.all(measure(replace(QUIET, baseline=0.15), step(0.85, 0.9)) > 0)
    assert np.all(measure(replace(QUIET, baseline=0.15), plane(0.9, np.deg2rad(70))) > 0)


def test_a_surface_turned_away_from_the_projector_is_dark() -> None:
    # Seen at 70 degrees, falling away from a projector that stands further round than the remaining 20 degrees.
    assert not np.any(measure(replace(QUIET, baseline=0.6), plane(0.9, np.deg2rad(-70)))[:, :-1])


@pytest.mark.slow
def test_shadow_equals_rays_to_the_projector() -> None:
    rng = np.random.default_rng(4)
    depth = np.full((1, 200), 0.9, np.float32)
    for _ in range(6):  # blocks that stand on the floor
        at, wide = rng.integers(0, 180), rng.integers(8, 30)
        depth[0, at : at + wide] = np.float32(rng.uniform(0.82, 0.88))
    K_row, b = camera_matrix(800.0, 200, 1), 0.2
    normals = np.broadcast_to(np.array([0, 0, -1], np.float32), (1, 200, 3))
    found = measure(replace(QUIET, baseline=b), (depth, normals), K=K_row)[0] == 0
    x = (np.arange(200) - K_row[0, 2]) / 800.0
    z = depth[0].astype(np.float64)
    for u in range(200):
        # Somewhere between the point and the projector the light passes below a block's top, edge to edge.
        t = np.linspace(0, 1, 4000)[1:]
        px, pz = x[u] * z[u] + t * (b - x[u] * z[u]), z[u] * (1 - t)
        column = np.rint(px / np.maximum(pz, 1e-9) * 800.0 + K_row[0, 2])
        inside = (column >= 0) & (column < 200)
        below = pz[inside] > depth[0, column[inside].astype(int)] + 2e-4
        if found[u] != below.any():
            # Only where a block's edge within half a pixel decides.
            assert np.any(np.diff(found[max(u - 2, 0) : u + 3].astype(int)))
    assert 10 < found.sum() < 150


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), preset=st.sampled_from(["good", "harsh"]))
def test_same_seed_same_bits_and_never_depth_from_nothing(seed: int, preset: str) -> None:
    depth, normals = step(0.8, 0.9)
    depth[::7, ::5] = 0
    before = depth.copy()
    first, again = (measure(light(preset), (depth, normals), seed) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(depth, before)
    assert first.dtype == np.float32
    assert np.all(np.isfinite(first))
    assert np.all(first[depth == 0] == 0)


def test_chance_does_not_depend_on_the_scene() -> None:
    good = light("good")
    states = []
    for scene in (plane(0.9), step(0.5, 1.0)):
        rng = np.random.default_rng(1)
        good.apply(*scene, K, rng)
        states.append(rng.random())
    assert states[0] == states[1]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: SensorModel(sigma_z=-1e-3), "sigma_z must not be negative"),
        (lambda: SensorModel(reference=0), "reference and edge_jump must be positive"),
        (lambda: SensorModel(edge_loss=2), r"edge_loss must be in \[0, 1\], got 2"),
        (lambda: SensorModel(max_incidence=2), r"max_incidence must be in \(0, pi / 2\], got 2"),
        (lambda: SensorModel(baseline=2), "baseline must be within 1 m, got 2"),
        (
            lambda: sensor_model("fine"),
            "none, good, harsh, stereo, tof or a DepthSensor, got 'fine'",
        ),
        (lambda: measure(QUIET, (plane(1)[0], plane(1)[1][:9])), r"normals must be \(480, 640, 3\)"),
        (lambda: measure(QUIET, (plane(1)[0][0], plane(1)[1])), r"depth_true must be \(N, N\)"),
        (lambda: measure(QUIET, plane(1), K=np.eye(4)), r"K must be \(3, 3\), got \(4, 4\)"),
    ],
)
def test_mistakes_are_named(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
