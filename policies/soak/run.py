"""The loop over the units of a soak test, which resumes where it was stopped, and the table of what was found."""

import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from binpick_env.jobs.folder_config import ensure_same_config
from binpick_env.jobs.text_tables import columns, counted
from perception.runtime.records import RecordError
from policies.soak.unit import Soak, UnitResult

_log = logging.getLogger(__name__)
SHOWN = 20  # number of problems of each kind that are printed; all are in the records


def run_soak(soak: Soak, out: Path, *, skip: int = 0) -> Iterator[UnitResult]:
    """Yield the results of all units; those whose records exist are read, the others are computed and written.

    Args:
        soak: Kind of soak test.
        out: Folder of the records, for every kind its own folder within.
        skip: Number of units at the beginning that are left out, because another machine does them.

    Raises:
        ValueError: The folder holds results of other settings.
    """
    folder = out / soak.kind
    ensure_same_config(folder / "config.json", soak.settings(), "results of soak")
    try:
        for unit in soak.units()[skip:]:
            path = folder / f"{unit}.json"
            result = _stored(path)
            if result is None:
                started = time.perf_counter()
                result = replace(soak.run(unit, folder), seconds=time.perf_counter() - started)
                result.save(path)
            yield result
    finally:
        soak.close()


def soak_table(kind: str, results: Sequence[UnitResult]) -> str:
    """Return counts, largest values and problems of one kind as text."""
    counts: dict[str, int] = {}
    largest: dict[str, float] = {}
    for result in results:
        for name, count in result.counts.items():
            counts[name] = counts.get(name, 0) + count
        for name, value in result.largest.items():
            largest[name] = max(largest.get(name, value), value)
    rows = [(kind, "")]
    rows += [(f"  {name}", str(count)) for name, count in counts.items()]
    rows += [(f"  {name}", f"{value:.3g}") for name, value in largest.items()]
    rows.append(("  seconds", f"{sum(result.seconds for result in results):.0f}"))
    problems = [f"  {result.name}: {problem}" for result in results for problem in result.problems]
    rows.append(("  problems", str(len(problems))))
    left = len(problems) - SHOWN
    more = [f"  and {counted(left, 'more problem')}, in the records"] if left > 0 else []
    return "\n".join([columns(rows), *problems[:SHOWN], *more])


def _stored(path: Path) -> UnitResult | None:
    """Return the result that a file holds, None if there is none."""
    if not path.exists():
        return None
    try:
        return UnitResult.load(path)
    except RecordError as error:
        _log.warning("%s is computed again: %s", path.stem, error)
        return None
