"""Benchmarks: measure, keep, compare."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import tyro
from tqdm import tqdm

from policies.bench_cell import bench_cell
from policies.benchmarks import Measurement, benchmark_table, comparison_table, load_benchmark, save_benchmark


@dataclass(frozen=True, kw_only=True)
class Files:
    """Where rows are kept, or read from."""

    save: Path | None = None  # keep the rows in this JSON file
    json: Path | None = None  # the same as --save
    compare: tuple[Path, Path] | None = None  # measure nothing: compare two kept files, the older one first


@dataclass(frozen=True, kw_only=True)
class Cell(Files):
    """Settling, stepping, camera frames by backend, attempts; everything on one core."""

    part: str = "tee"  # catalogue name or mesh file
    count: int = 25  # parts in the bin
    seed: int = 0  # of the first pile
    repeats: int = 5  # of every row but those of picking
    picks: int = 20  # attempts behind the rows of picking


@dataclass(frozen=True, kw_only=True)
class Segmentation(Files):
    """Labelled scenes, a frame from pixels to labelled points, training with and without what makes it fast."""

    part: str = "tee"  # catalogue name or mesh file, with weights
    seed: int = 0  # of the scenes
    repeats: int = 5  # of every row
    threads: int = 2  # of torch


def cell(args: tyro.conf.OmitArgPrefixes[Cell]) -> int:
    """Settling, stepping, camera frames by backend, attempts; everything on one core."""
    return _bench("cell", args, lambda: bench_cell(args.part, args.count, args.seed, args.repeats, args.picks))


def segmentation(args: tyro.conf.OmitArgPrefixes[Segmentation]) -> int:
    """Labelled scenes, a frame from pixels to labelled points, training with and without what makes it fast."""
    from policies.bench_segmentation import bench_segmentation  # torch, which takes seconds to import

    measure = partial(bench_segmentation, args.part, args.seed, args.repeats, args.threads)
    return _bench("segmentation", args, measure)


def _bench(name: str, files: Files, measure: Callable[[], Iterator[Measurement]]) -> int:
    try:
        if files.compare is not None:
            print(comparison_table(*(load_benchmark(path) for path in files.compare)))
            return 0
        rows = list(tqdm(measure(), desc=name, unit="row"))
    except (ValueError, OSError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(benchmark_table(rows))
    for path in filter(None, (files.save, files.json)):
        save_benchmark(path, name, rows)
        print(f"kept in   {path}")
    return 0


if __name__ == "__main__":
    app = tyro.extras.SubcommandApp()
    app.command(name="cell")(cell)
    app.command(name="segmentation")(segmentation)
    sys.exit(app.cli(description=__doc__))
