"""Candidates as arrays: each feature by hand, and what padding and mask promise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from binpick_env.candidates import FEATURES, MAX_CANDIDATES, PoseCandidate, candidate_row, pad_candidates
from binpick_env.config import BinConfig
from perception.geometry import Floats, make_transform, random_rotation, rotation_about, rotation_from_6d

WORKSPACE = BinConfig().workspace()


def candidate(T_world_part: Floats, **facts: float) -> PoseCandidate:
    values = {"score": 0.9, "visible_fraction": 0.8, "top": 0.07, "fill": 0.6} | facts
    return PoseCandidate(T_world_part=T_world_part, centre_world=T_world_part[:3, 3], **values)  # type: ignore[arg-type]


def at_bin(x: float, y: float, z: float, rotation: Floats | None = None) -> Floats:
    return WORKSPACE.T_world_bin @ make_transform(rotation, (x, y, z))


def test_a_row_by_hand() -> None:
    row = candidate_row(candidate(at_bin(0.05, -0.10, 0.03, rotation_about((0, 0, 1), np.pi / 2))), WORKSPACE)
    by_name = dict(zip(FEATURES, row, strict=True))
    assert row.dtype == np.float32
    assert by_name == pytest.approx(
        {
            "x": 0.05,
            "y": -0.10,
            "z": 0.03,
            "rotation_0": 0.0,
            "rotation_1": 1.0,
            "rotation_2": 0.0,
            "rotation_3": -1.0,
            "rotation_4": 0.0,
            "rotation_5": 0.0,
            "score": 0.9,
            "visible_fraction": 0.8,
            "height": 0.07,
            "wall_distance": 0.03,  # the wall at y = -0.13
            "fill": 0.6,
        },
        abs=1e-6,
    )


def test_the_position_is_the_centre_and_not_the_part_frame() -> None:
    shifted = PoseCandidate(
        T_world_part=at_bin(0.0, 0.0, 0.0),
        centre_world=at_bin(0.02, 0.01, 0.04)[:3, 3],
        score=1.0,
        visible_fraction=1.0,
        top=0.06,
        fill=1.0,
    )
    row = candidate_row(shifted, WORKSPACE)
    np.testing.assert_allclose(row[:3], (0.02, 0.01, 0.04), atol=1e-6)
    assert row[FEATURES.index("wall_distance")] == pytest.approx(0.12, abs=1e-6)


def test_a_centre_over_the_wall_has_a_negative_distance() -> None:
    assert candidate_row(candidate(at_bin(0.19, 0.0, 0.15)), WORKSPACE)[FEATURES.index("wall_distance")] < 0


@settings(max_examples=40)
@given(seed=st.integers(0, 2**31), near=st.booleans())
def test_the_rotation_is_recovered(seed: int, near: bool) -> None:
    rng = np.random.default_rng(seed)
    rotation = rotation_about(rng.normal(size=3), 1e-7) if near else random_rotation(rng)
    row = candidate_row(candidate(at_bin(0.0, 0.0, 0.05, rotation)), WORKSPACE)
    np.testing.assert_allclose(rotation_from_6d(row[3:9].astype(np.float64)), rotation, atol=1e-6)


@settings(max_examples=40, deadline=None)
@given(count=st.integers(0, MAX_CANDIDATES + 8), seed=st.integers(0, 2**31))
def test_padding_and_mask(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    many = [candidate(at_bin(*rng.uniform(-0.1, 0.1, 3), random_rotation(rng))) for _ in range(count)]
    rows, mask = pad_candidates(many, WORKSPACE)
    kept = min(count, MAX_CANDIDATES)
    assert rows.shape == (MAX_CANDIDATES, len(FEATURES))
    assert (rows.dtype, mask.dtype) == (np.float32, np.int8)
    np.testing.assert_array_equal(mask, np.arange(MAX_CANDIDATES) < kept)
    np.testing.assert_array_equal(rows[kept:], 0.0)
    for k in range(kept):
        np.testing.assert_array_equal(rows[k], candidate_row(many[k], WORKSPACE))
        assert np.any(rows[k] != 0)


def test_there_is_room_for_a_standard_bin() -> None:
    assert MAX_CANDIDATES >= 30
    assert len(FEATURES) == len(set(FEATURES)) == 14
