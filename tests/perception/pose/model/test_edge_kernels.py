"""The compiled kernels of mesh edges against naive twins."""

import networkx as nx
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.pose.model._edge_kernels import bounding, chains, cross_products, facing


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1.0]))
def test_faces_and_edges_in_front_agree_with_the_naive_twin(seed: int, weight: float) -> None:
    rng = np.random.default_rng(seed)
    normals, corners = rng.normal(size=(40, 3)), rng.normal(size=(40, 3))
    eye = np.append(rng.normal(size=3), weight)
    front = facing(normals, corners, eye, 0.1)
    heights = [normal @ (eye[:3] - eye[3] * corner) for normal, corner in zip(normals, corners, strict=True)]
    assert front.tolist() == [height > 0.1 for height in heights]
    faces, crease = rng.integers(0, 40, (100, 2)), rng.random(100) < 0.5
    expected = [
        k
        for k, (one, other) in enumerate(faces)
        if front[one] != front[other] or (front[one] and front[other] and crease[k])
    ]
    assert bounding(front, faces, crease).tolist() == expected


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
def test_chains_are_the_connected_components_of_the_edges(seed: int, edges: int) -> None:
    ends = np.random.default_rng(seed).integers(0, 50, (edges, 2))
    labels = chains(ends)
    components = list(nx.connected_components(nx.Graph(ends.tolist())))
    expected = np.array([next(k for k, c in enumerate(components) if a in c) for a in ends[:, 0].tolist()])
    np.testing.assert_array_equal(labels[:, None] == labels, expected[:, None] == expected)


def test_no_edges_have_no_chains() -> None:
    assert len(chains(np.zeros((0, 2), np.int64))) == 0


def test_cross_products_have_the_bits_of_numpy() -> None:
    first, second = np.random.default_rng(0).normal(size=(2, 500, 3))
    np.testing.assert_array_equal(cross_products(first, second), np.cross(first, second))
