"""How time and memory of a frame grow: exponents of powers that are known, and a frame that is measured."""

from typing import Any

import pytest

from binpick_env.options import CellOptions
from policies.benchmarks import Steps, bench_scaling, scaling

STEPS = Steps(counts=(5, 10, 40), count=10, widths=(640, 1280))


def test_exponents_are_those_of_powers(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, int, int]] = []

    def measure(options: CellOptions, count: int, seed: int, repeats: int) -> Any:
        asked.append((count, options.width, options.height))
        pixels = options.width * options.height
        times = tuple(count * pixels**0.5 * (1 + k) for k in range(repeats))
        return scaling._Frames(milliseconds=times, megabytes=count**0.5 * pixels)

    monkeypatch.setattr(scaling, "_measure", measure)
    rows = {row.name: row for row in bench_scaling(CellOptions(), STEPS, 0, 3)}
    assert asked == [(5, 1280, 960), (10, 1280, 960), (40, 1280, 960), (10, 640, 480)]  # nothing twice
    found = {name: row.median for name, row in rows.items() if "exponent" in name}
    assert found == pytest.approx(
        {
            "time over parts: exponent": 1.0,
            "memory over parts: exponent": 0.5,
            "time over pixels: exponent": 0.5,
            "memory over pixels: exponent": 1.0,
        }
    )
    assert rows["10 parts, 0.31 megapixels: frame"].values == pytest.approx([5542.6, 11085.1, 16627.7], rel=1e-4)


@pytest.mark.slow
def test_a_frame_is_measured() -> None:
    cell = CellOptions(part="bracket", width=320, height=240)
    rows = list(bench_scaling(cell, Steps(counts=(2,), count=2, widths=(320,)), 0, 1))
    assert [row.name for row in rows] == ["2 parts, 0.077 megapixels: frame", "2 parts, 0.077 megapixels: memory"]
    assert min(row.median for row in rows) > 0


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"counts": ()}, r"counts must be positive, got \(\)"),
        ({"count": 0}, "count must be positive, got 0"),
        ({"widths": (640, -1)}, r"widths must be positive, got \(640, -1\)"),
    ],
)
def test_steps_that_make_no_sense_are_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Steps(**{"counts": (5,), "count": 5, "widths": (640,)} | changes)
    with pytest.raises(ValueError, match="repeats must be at least 1, got 0"):
        list(bench_scaling(CellOptions(), STEPS, 0, 0))
