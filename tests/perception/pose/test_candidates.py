"""The paper's candidates: groups with about as many boundary points as a whole part."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perception.pose import candidates
from perception.pose.candidates import expected_points, nearest_groups
from perception.pose.model.appearances import edge_appearances
from tests.perception.pose import observed_part as at


@pytest.mark.parametrize(
    ("sizes", "expected", "count", "nearest"),
    [
        ([100, 50, 98, 109, 300], 100, 3, [0, 2, 3]),
        ([100, 50, 98, 109, 300], 100, 5, [0, 2, 3, 1, 4]),
        ([100, 50, 98, 109, 300], 100, 1, [0]),
        ([90, 110, 95, 105], 100, 3, [2, 3, 0]),  # ties go to the lower index
        ([0, 200], 100, 3, [0, 1]),  # fewer groups than asked for
        ([], 100, 3, []),
    ],
)
def test_the_nearest_groups_by_hand(sizes: list[int], expected: int, count: int, nearest: list[int]) -> None:
    assert nearest_groups(sizes, expected, count) == nearest


def test_three_groups_are_taken() -> None:
    assert nearest_groups([97, 98, 99, 100], 100) == [3, 2, 1]


@given(st.lists(st.integers(0, 400), max_size=12), st.integers(1, 300), st.floats(0, 1))
def test_groups_within_the_tolerance_come_first(sizes: list[int], expected: int, tolerance: float) -> None:
    chosen = nearest_groups(sizes, expected, 12, tolerance)
    assert sorted(chosen) == list(range(len(sizes)))
    away = [abs(sizes[k] - expected) for k in chosen]
    inside = [far <= tolerance * expected for far in away]
    assert inside == sorted(inside, reverse=True)
    assert away == sorted(away)
    assert all(a < b for a, b, same in zip(chosen, chosen[1:], np.diff(away) == 0, strict=False) if same)


def test_expected_points_are_those_of_the_parts_appearances(monkeypatch: pytest.MonkeyPatch) -> None:
    part = at.ell()
    few = edge_appearances(part, subdivisions=1)
    monkeypatch.setattr(candidates, "edge_appearances", lambda part: few)
    assert expected_points(part, at.K, 0.5) == few.expected_points(at.K, 0.5) == round(few.lengths.max() * 2400)


@pytest.mark.parametrize(("expected", "count"), [(0, 3), (100, 0), (-1, 3)])
def test_a_bad_number_is_refused(expected: int, count: int) -> None:
    with pytest.raises(ValueError, match=f"expected and count must be at least 1, got {expected} and {count}"):
        nearest_groups([10], expected, count)


@pytest.mark.parametrize("tolerance", [-0.1, np.nan])
def test_a_bad_tolerance_is_refused(tolerance: float) -> None:
    with pytest.raises(ValueError, match=f"tolerance must be 0 or more, got {tolerance}"):
        nearest_groups([10], 10, tolerance=tolerance)
