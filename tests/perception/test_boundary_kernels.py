"""The compiled kernels of boundary points against their plain twins, and cases worked out by hand."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from perception import _boundary_kernels as _kernels
from perception.geometry import Floats
from tests.perception.flat_scene import K
from tests.reference import boundary_twin


def random_depth(rng: np.random.Generator) -> np.ndarray:
    """Return a small image of a few levels, with ties and holes."""
    shape = rng.integers(1, 14, size=2)
    depth = rng.choice([0.9, 0.899, 0.8975, 0.85, 0.7], size=shape) + rng.choice([0, 1e-4], size=shape)
    depth[rng.random(shape) < rng.choice([0.0, 0.3, 0.8, 1.0])] = 0.0
    return depth.astype(np.float32)


def random_pixels(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Return a random set of different pixels (u, v) in any order, perhaps none."""
    flat_index = rng.permutation(shape[0] * shape[1])[: rng.integers(0, shape[0] * shape[1] + 1)]
    return np.column_stack([flat_index % shape[1], flat_index // shape[1]])


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_foreground_pixels_equal_their_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth = random_depth(rng)
    pixels = random_pixels(rng, depth.shape)
    radius = int(rng.integers(0, 3))
    arguments = depth, radius, radius + int(rng.integers(0, 4)), 0.003
    found = _kernels.foreground_pixels(pixels, *arguments)
    np.testing.assert_array_equal(found, boundary_twin.foreground_pixels(pixels, *arguments))
    order = rng.permutation(len(pixels))
    np.testing.assert_array_equal(_kernels.foreground_pixels(pixels[order], *arguments), found[order])


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_edge_tangents_equal_their_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    height, width = rng.integers(1, 14, size=2)
    pixels = random_pixels(rng, (height, width))
    z = rng.choice([0.9, 0.901, 0.95], size=len(pixels)) + rng.normal(0, 5e-4, len(pixels))
    points = z[:, None] * np.column_stack([(pixels - K[:2, 2]) / 520.0, np.ones(len(pixels))])
    window = int(rng.integers(1, 5))

    def fast(order: np.ndarray) -> tuple[Floats, Floats]:
        index_at = np.full((height, width), -1, np.int32)
        index_at[pixels[order, 1], pixels[order, 0]] = np.arange(len(order))
        return _kernels.edge_tangents(pixels[order], points[order], index_at, K, window, 0.003)

    tangents, linearity = fast(np.arange(len(pixels)))
    slow_tangents, slow_linearity = boundary_twin.edge_tangents(pixels, points, K, window, 0.003)
    np.testing.assert_allclose(linearity, slow_linearity, atol=1e-9)
    clear = linearity > 1e-6  # elsewhere every direction is as good, or there is none
    dots = np.abs(np.sum(tangents * slow_tangents, axis=1))
    np.testing.assert_allclose(dots[clear], 1.0, atol=1e-7)
    np.testing.assert_array_equal((tangents == 0).all(axis=1), (slow_tangents == 0).all(axis=1))
    order = rng.permutation(len(pixels))
    for once, again in zip((tangents, linearity), fast(order), strict=True):
        np.testing.assert_array_equal(once[order], again)


def test_a_lonely_point_has_no_tangent() -> None:
    index_at = np.full((5, 5), -1, np.int32)
    index_at[2, 3] = 0
    pixels, points = np.array([(3, 2)]), np.array([(0.0, 0.0, 0.9)])
    tangents, linearity = _kernels.edge_tangents(pixels, points, index_at, K, 8, 0.003)
    np.testing.assert_array_equal(tangents, [[0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(linearity, [0.0])


def test_a_whole_window_is_a_square_and_takes_no_pixel_beside_it() -> None:
    depth = np.full((9, 9), 0.9, np.float32)
    depth[7, 7] = depth[4, 8] = 0.5
    assert _kernels.foreground_pixels(np.array([[4, 4]]), depth, 3, 4, 0.003).tolist() == [[7, 7]]
