"""Repeated timings with their spread, which can be saved with the machine they were taken on, and compared."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.jobs.text_tables import columns
from perception.runtime.files import json_text, write_atomically
from perception.runtime.provenance import command_line, git_commit, machine, versions


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """One row of a benchmark.

    Attributes:
        name: Measured quantity; rows of two runs are compared if their names are equal.
        unit: Unit of the values.
        values: Measured value of each repeat.
    """

    name: str
    unit: str
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.values:
            raise ValueError(f"{self.name!r} needs at least one value")

    @property
    def median(self) -> float:
        """Median of the values, which is compared between runs."""
        return float(np.median(self.values))


def repeat(name: str, unit: str, sample: Callable[[int], float], repeats: int) -> Measurement:
    """Measure ``sample(k)`` for every k below ``repeats``.

    Args:
        name: Measured quantity.
        unit: Unit of the values.
        sample: Function that takes one measurement, given its number.
        repeats: Number of measurements.
    """
    return Measurement(name=name, unit=unit, values=tuple(sample(k) for k in range(repeats)))


def seconds(call: Callable[[], object]) -> float:
    """Return the wall clock time of ``call()`` [s]."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def benchmark_table(rows: Sequence[Measurement]) -> str:
    """Return the medians and their spread as text."""
    cells: list[tuple[str, ...]] = [("", "median", "lowest", "highest", "repeats")]
    for row in rows:
        numbers = (f"{value:.4g}" for value in (row.median, min(row.values), max(row.values)))
        cells.append((f"{row.name} [{row.unit}]", *numbers, str(len(row.values))))
    return columns(cells)


def comparison_table(before: Sequence[Measurement], after: Sequence[Measurement]) -> str:
    """Return the medians of two runs side by side; a change is noise if the ranges of values overlap.

    Raises:
        ValueError: The runs have no measurement in common.
    """
    old = {row.name: row for row in before}
    cells: list[tuple[str, ...]] = [("", "before", "after", "change", "")]
    for row in after:
        if row.name not in old:
            continue
        past = old[row.name]
        noise = min(row.values) <= max(past.values) and min(past.values) <= max(row.values)
        change = row.median / past.median - 1 if past.median else np.nan
        numbers = (f"{past.median:.4g}", f"{row.median:.4g}", f"{100 * change:+.1f} %")
        cells.append((f"{row.name} [{row.unit}]", *numbers, "within noise" if noise else ""))
    if len(cells) == 1:
        raise ValueError("the two files have no measurement in common")
    return columns(cells)


def save_benchmark(path: Path, name: str, rows: Sequence[Measurement]) -> None:
    """Write a benchmark as JSON, with machine, versions, commit and command."""
    facts: dict[str, Any] = {"benchmark": name, "machine": machine()}
    facts |= {"commit": git_commit(), "command": command_line(), "versions": versions()}
    write_atomically(path, json_text({**facts, "rows": [asdict(row) for row in rows]}))


def load_benchmark(path: Path) -> list[Measurement]:
    """Read the rows that :func:`save_benchmark` wrote.

    Raises:
        ValueError: The file is not a benchmark.
    """
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))["rows"]
        return [Measurement(name=r["name"], unit=r["unit"], values=tuple(r["values"])) for r in rows]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is not a benchmark that bench.py saved ({error})") from error
