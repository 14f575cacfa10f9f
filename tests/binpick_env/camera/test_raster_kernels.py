"""The rasteriser's kernels against plain loops over all pixels: the same bits."""

import numpy as np
import pytest
import trimesh

from binpick_env.camera import _normal_kernels, _raster_kernels
from binpick_env.camera.view import pixel_slopes
from perception.geometry import Floats, camera_matrix, make_transform, random_rotation, transform_points
from tests.reference import raster_twin

WIDTH, HEIGHT = 36, 28
K = camera_matrix(40.0, WIDTH, HEIGHT)
SLOPES = pixel_slopes(K, WIDTH, HEIGHT)
WHOLE = np.array([0, 0, WIDTH, HEIGHT])


def random_triangles(rng: np.random.Generator, count: int = 60) -> tuple[Floats, np.ndarray]:
    """Return vertices and faces: large and thin ones, some behind the eye, beside the image or with level edges."""
    vertices = rng.normal(size=(3 * count, 3)) * (0.4, 0.3, 0.6) + (0, 0, 1.0)
    thin = rng.random(count) < 0.4
    vertices[2::3][thin] = vertices[1::3][thin] + 0.02 * rng.normal(size=(thin.sum(), 3))
    level = rng.random(count) < 0.3
    vertices[1::3, 1:][level] = vertices[::3, 1:][level]
    beside = rng.random(count) < 0.1
    vertices[np.repeat(beside, 3)] += (5.0, 0, 0)
    return vertices, np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def draw(vertices: Floats, faces: np.ndarray, two_sided: np.ndarray, region: np.ndarray = WHOLE, each: int = 6):
    """Return the kernel's z-buffer and faces; every ``each`` faces are a geom."""
    depth, face_at = np.full((HEIGHT, WIDTH), np.inf), np.full((HEIGHT, WIDTH), -1, np.int32)
    starts = np.arange(0, len(faces), each)
    face_range = np.stack([starts, np.minimum(starts + each, len(faces))], axis=1)
    vertex_range = np.stack([faces[a:b].min() + np.zeros(2, int) for a, b in face_range])
    vertex_range[:, 1] = [faces[a:b].max() + 1 for a, b in face_range]
    ranges = vertex_range.astype(np.int64), face_range.astype(np.int64)
    _raster_kernels.rasterise(vertices, faces, *ranges, two_sided, K, *SLOPES, region, depth, face_at)
    return depth, face_at


@pytest.mark.parametrize("seed", range(5))
def test_triangles_are_drawn_where_plain_loops_draw_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = random_triangles(rng)
    two_sided = rng.random(len(faces)) < 0.7
    region = WHOLE if seed < 3 else np.array([5, 3, 29, 20])
    depth, face_at = draw(vertices, faces, two_sided, region)
    expected = raster_twin.rasterise(vertices, faces, two_sided, SLOPES, region)
    np.testing.assert_array_equal(face_at, expected[1])
    np.testing.assert_array_equal(depth, expected[0])
    assert len(np.unique(face_at)) > 3


def test_edges_through_pixel_centres() -> None:
    """All corners are at pixels' centres, at depths that keep the edges on them."""
    rng = np.random.default_rng(0)
    columns, rows = rng.integers(0, WIDTH, 240), rng.integers(0, HEIGHT, 240)
    columns[1::3][::2] = columns[::3][::2]
    rays = np.stack([SLOPES[0][columns], SLOPES[1][rows], np.ones(240)], axis=1)
    vertices, faces = rays * rng.choice([0.5, 1.0, 2.0], (240, 1)), np.arange(240, dtype=np.int32).reshape(-1, 3)
    two_sided = np.ones(len(faces), bool)
    for t in range(len(faces)):
        depth, face_at = draw(vertices, faces[t : t + 1], two_sided)
        expected = raster_twin.rasterise(vertices, faces[t : t + 1], two_sided, SLOPES, WHOLE)
        np.testing.assert_array_equal(face_at, expected[1])
        np.testing.assert_array_equal(depth, expected[0])


@pytest.mark.parametrize("half", [0.5, 0.4875, 0.3])
def test_a_box_with_edges_along_rows_and_through_pixel_centres(half: float) -> None:
    """At depth 1 a side of 0.4875 m ends at a pixel's centre."""
    box = trimesh.creation.box((2 * half, 1.4 * half, 0.5))
    vertices, faces = np.add(box.vertices, (0, 0, 1.25)), np.asarray(box.faces, np.int32)
    closed = np.zeros(len(faces), bool)
    depth, face_at = draw(vertices, faces, closed, each=len(faces))
    expected = raster_twin.rasterise(vertices, faces, closed, SLOPES, WHOLE)
    np.testing.assert_array_equal(face_at, expected[1])
    np.testing.assert_array_equal(depth, expected[0])


@pytest.mark.parametrize("seed", range(3))
def test_normals_are_those_of_plain_loops(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = random_triangles(rng, 8)
    corners = rng.normal(size=(len(faces), 3, 3)).astype(np.float32)
    corners[::4] = (1, 1, 0)  # with the first rotation, products that are 0 of either sign
    face_geom = np.arange(len(faces), dtype=np.int32) % 4
    R = np.stack([np.eye(3), *(random_rotation(rng) for _ in range(3))])
    _, face_at = draw(vertices, faces, np.ones(len(faces), bool))
    normals = np.full((HEIGHT, WIDTH, 3), 7, np.float32)
    _normal_kernels.interpolate_normals(vertices, faces, corners, face_geom, R, *SLOPES, WHOLE, face_at, normals)
    expected = np.full((HEIGHT, WIDTH, 3), 7, np.float32)
    for v, u in np.argwhere(face_at >= 0):
        t = face_at[v, u]
        normal = raster_twin.normal_at(vertices[faces[t]], corners[t], R[face_geom[t]], SLOPES[0][u], SLOPES[1][v])
        expected[v, u] = 7 if normal is None else normal
    np.testing.assert_array_equal(normals.view(np.int32), expected.view(np.int32))  # the sign of 0, too
    assert (np.diff(np.flatnonzero(np.diff(face_at.ravel()))) > _normal_kernels.LONG).any()  # long runs, and short ones


@pytest.mark.parametrize("seed", range(3))
def test_silhouettes_have_the_pixels_that_the_mesh_covers_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.2)
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
    T = [make_transform(random_rotation(rng), rng.normal(size=3) * 0.2 + (0, 0, 1)) for _ in range(4)]
    stamp = np.full((HEIGHT, WIDTH), -1, np.int32)
    R, t = np.stack([pose[:3, :3] for pose in T]), np.stack([pose[:3, 3] for pose in T])
    counts = _raster_kernels.count_silhouettes(vertices, faces, R, t, K, *SLOPES, WHOLE, stamp)
    for count, pose in zip(counts, T, strict=True):
        _, face_at = raster_twin.rasterise(
            transform_points(pose, vertices), faces, np.zeros(len(faces), bool), SLOPES, WHOLE
        )
        assert count == np.count_nonzero(face_at >= 0) > 5


def test_faces_become_geoms_and_what_is_empty_has_no_depth() -> None:
    face_at, depth = np.array([[0, -1], [2, 1]], np.int32), np.array([[0.5, np.inf], [0.7, 0.6]])
    _raster_kernels.faces_to_geoms(face_at, np.array([8, 8, 9], np.int32), depth)
    assert face_at.tolist() == [[8, -1], [9, 8]]
    assert depth.tolist() == [[0.5, 0.0], [0.7, 0.6]]
