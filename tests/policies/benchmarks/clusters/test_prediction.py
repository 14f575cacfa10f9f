"""What was measured of a cluster, and what is predicted from it."""

import json
from pathlib import Path

import pytest

from policies.benchmarks.clusters import Items, Machines, measure_transport, predict, save_prediction
from policies.benchmarks.measurement import Measurement

ROWS = (
    Measurement(name="taking an item", unit="ms", values=(1.0, 2.0, 9.0)),
    Measurement(name="taking a megabyte", unit="ms", values=(10.0,)),
)


def test_predictions_follow_from_the_medians(tmp_path: Path) -> None:
    clusters = [Machines(cores=cores, start=0.0, compilation=0.0) for cores in (1, 1000)]
    predicted = predict(ROWS, Items(count=3000, seconds=1.0, megabytes=0.1), clusters)
    # The process that takes results needs 3 ms for each.
    assert predicted.schedules[1].seconds == pytest.approx(3000 * 0.003 + 2004 * 0.002, rel=0.3)
    lines = str(predicted).splitlines()
    assert [line.split()[0] for line in lines[-2:]] == ["1", "1000"]
    save_prediction(tmp_path / "predicted.json", predicted)
    kept = json.loads((tmp_path / "predicted.json").read_text())
    assert [each["cores"] for each in kept["machines"]] == [1, 1000]
    assert kept["schedules"][1]["seconds"] == predicted.schedules[1].seconds


def test_transport_is_measured_by_items_that_write_files() -> None:
    rows = list(measure_transport(1, 3, 2))
    assert [(row.name, row.unit, len(row.values)) for row in rows] == [
        ("start of a worker", "s", 1),
        ("taking an item", "ms", 2),
        ("taking a megabyte", "ms", 2),
    ]
    assert min(min(row.values) for row in rows) >= 0
    with pytest.raises(ValueError, match="items and repeats must be at least 1, got 0 and 1"):
        list(measure_transport(1, 0, 1))
