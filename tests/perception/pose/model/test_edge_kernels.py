"""The compiled kernels of mesh edges against naive twins."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.pose.model._edge_kernels import bounding, facing


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
