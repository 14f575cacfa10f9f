"""Benchmarks: measure, keep, compare."""

import sys
from dataclasses import dataclass
from pathlib import Path

import tyro
from tqdm import tqdm

from policies.bench_cell import bench_cell
from policies.benchmarks import benchmark_table, comparison_table, load_benchmark, save_benchmark


@dataclass(frozen=True, kw_only=True)
class Cell:
    """Settling, stepping, camera frames by backend, attempts; everything on one core."""

    part: str = "tee"  # catalogue name or mesh file
    count: int = 25  # parts in the bin
    seed: int = 0  # of the first pile
    repeats: int = 5  # of every row but those of picking
    picks: int = 20  # attempts behind the rows of picking
    save: Path | None = None  # keep the rows in this JSON file
    json: Path | None = None  # the same as --save
    compare: tuple[Path, Path] | None = None  # measure nothing: compare two kept files, the older one first


def cell(args: tyro.conf.OmitArgPrefixes[Cell]) -> int:
    """Settling, stepping, camera frames by backend, attempts; everything on one core."""
    try:
        if args.compare is not None:
            print(comparison_table(*(load_benchmark(path) for path in args.compare)))
            return 0
        stream = bench_cell(args.part, args.count, args.seed, args.repeats, args.picks)
        rows = list(tqdm(stream, desc="cell", unit="row"))
    except (ValueError, OSError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(benchmark_table(rows))
    for path in filter(None, (args.save, args.json)):
        save_benchmark(path, "cell", rows)
        print(f"kept in   {path}")
    return 0


if __name__ == "__main__":
    app = tyro.extras.SubcommandApp()
    app.command(name="cell")(cell)
    sys.exit(app.cli(description=__doc__))
