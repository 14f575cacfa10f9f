"""Attempts a second: which modes are timed, and how they are added up."""

import pytest

from binpick_env.options import CellOptions
from policies.benchmarks.selection import MODES, bench_selection


@pytest.mark.parametrize(("picks", "workers"), [(0, 2), (5, 0)])
def test_nothing_cannot_be_timed(picks: int, workers: int) -> None:
    with pytest.raises(ValueError, match=f"picks and workers must be at least 1, got {picks} and {workers}"):
        list(bench_selection(CellOptions(), 0, picks, workers))


def test_processes_are_added_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "policies.benchmarks.selection._seconds", lambda arguments, *_: 5.0 if arguments.get("fast") else 20.0
    )
    monkeypatch.setattr("policies.benchmarks.selection.map_indices", lambda work, indices, workers: map(work, indices))
    rows = list(bench_selection(CellOptions(), 0, picks=10, workers=2))
    assert [row.values for row in rows[:4]] == [(0.5, 0.5), (1.0,), (2.0, 2.0), (4.0,)]
    assert len(rows) == 2 * len(MODES)
    assert rows[1].name == "attempts of 2 processes, in full"


@pytest.mark.slow
def test_a_mode_is_timed() -> None:
    from policies.benchmarks.selection import _seconds

    arguments = {"part": "tee", "num_parts": (2, 3), "perception": "oracle", "threads": 1, "fast": True}
    assert _seconds(arguments, 31, 2, 0) > 0
