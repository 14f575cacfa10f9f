import json
import os
from pathlib import Path

import pytest

from policies.benchmarks.measurement import (
    Measurement,
    benchmark_table,
    comparison_table,
    load_benchmark,
    repeat,
    save_benchmark,
)


def row(*values: float, name: str = "frame") -> Measurement:
    return Measurement(name=name, unit="s", values=values)


def test_rows_survive_their_file_with_where_they_come_from(tmp_path: Path) -> None:
    rows = [row(1.0, 3.0, 2.0), row(5.0, name="drop")]
    save_benchmark(tmp_path / "b.json", "cell", rows)
    assert load_benchmark(tmp_path / "b.json") == rows
    values = json.loads((tmp_path / "b.json").read_text())
    assert values["machine"].endswith(f", {os.cpu_count()} cores")
    assert {"benchmark", "machine", "commit", "command", "versions"} <= set(values)


def test_a_table_shows_median_and_spread() -> None:
    assert benchmark_table([row(1.0, 4.0, 2.0)]).splitlines()[1].split() == ["frame", "[s]", "2", "1", "4", "3"]


def test_a_comparison_tells_change_from_noise() -> None:
    noisy, faster = (comparison_table([row(1.0, 2.0, 3.0)], [row(*v)]) for v in ((1.5, 1.8, 2.5), (0.4, 0.5, 0.6)))
    assert "-10.0 %" in noisy
    assert "within noise" in noisy
    assert "-75.0 %" in faster
    assert "within noise" not in faster


def test_repeats_are_numbered() -> None:
    assert repeat("x", "s", float, 3).values == (0.0, 1.0, 2.0)


def test_nonsense_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text("{}")
    with pytest.raises(ValueError, match=r"x\.json is not a benchmark"):
        load_benchmark(tmp_path / "x.json")
    with pytest.raises(ValueError, match="no measurement in common"):
        comparison_table([row(1.0)], [row(1.0, name="drop")])
    with pytest.raises(ValueError, match="'frame' needs at least one value"):
        row()
