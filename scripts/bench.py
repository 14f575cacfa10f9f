"""Benchmarks: measure, keep, compare."""

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import tyro
from tqdm import tqdm

from policies.benchmarks.cell import bench_cell
from policies.benchmarks.measurement import (
    Measurement,
    benchmark_table,
    comparison_table,
    load_benchmark,
    save_benchmark,
)

Row = TypeVar("Row", bound=Measurement)


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


@dataclass(frozen=True, kw_only=True)
class Pose(Files):
    """Pose estimation against OpenCV's and Open3D's on the same inputs, with one thread and two."""

    part: str = "tee"  # catalogue name or mesh file
    count: int = 20  # scenes, each of three segments
    whole_scenes: int = 2  # of them, searched as a whole, too
    seed: int = 0  # of the scenes
    opencv_python: Path | None = None  # interpreter of an environment with opencv-contrib-python-headless
    open3d_python: Path | None = None  # interpreter of an environment with open3d-cpu


@dataclass(frozen=True, kw_only=True)
class Selection(Files):
    """Attempts a second of BinPickSelect-v0, in full and fast, in as many processes as there are workers."""

    part: str = "tee"  # catalogue name or mesh file
    seed: int = 0  # of the first pile
    picks: int = 40  # attempts of each process
    workers: int = 2  # processes, one core each


def cell(args: tyro.conf.OmitArgPrefixes[Cell]) -> int:
    """Settling, stepping, camera frames by backend, attempts; everything on one core."""
    return _bench("cell", args, lambda: bench_cell(args.part, args.count, args.seed, args.repeats, args.picks))


def segmentation(args: tyro.conf.OmitArgPrefixes[Segmentation]) -> int:
    """Labelled scenes, a frame from pixels to labelled points, training with and without what makes it fast."""
    from policies.benchmarks.segmentation import bench_segmentation  # torch, which takes seconds to import

    measure = partial(bench_segmentation, args.part, args.seed, args.repeats, args.threads)
    return _bench("segmentation", args, measure)


def pose(args: tyro.conf.OmitArgPrefixes[Pose]) -> int:
    """Pose estimation against OpenCV's and Open3D's on the same inputs, with one thread and two."""
    from policies.benchmarks.pose import bench_pose, pose_table  # compiled kernels, which take seconds to import

    interpreters = {"opencv": args.opencv_python, "open3d": args.open3d_python}
    measure = partial(bench_pose, args.part, args.seed, args.count, args.whole_scenes, interpreters)
    return _bench("pose", args, measure, pose_table)


def selection(args: tyro.conf.OmitArgPrefixes[Selection]) -> int:
    """Attempts a second of BinPickSelect-v0, in full and fast, in as many processes as there are workers."""
    from policies.benchmarks.selection import bench_selection  # compiled kernels, which take seconds to import

    return _bench("selection", args, lambda: bench_selection(args.part, args.seed, args.picks, args.workers))


def _bench(
    name: str,
    files: Files,
    measure: Callable[[], Iterator[Row]],
    table: Callable[[Sequence[Row]], str] = benchmark_table,
) -> int:
    try:
        if files.compare is not None:
            print(comparison_table(*(load_benchmark(path) for path in files.compare)))
            return 0
        rows = list(tqdm(measure(), desc=name, unit="row"))
    except (ValueError, OSError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(table(rows))
    for path in filter(None, (files.save, files.json)):
        save_benchmark(path, name, rows)
        print(f"kept in   {path}")
    return 0


if __name__ == "__main__":
    app = tyro.extras.SubcommandApp()
    app.command(name="cell")(cell)
    app.command(name="segmentation")(segmentation)
    app.command(name="pose")(pose)
    app.command(name="selection")(selection)
    sys.exit(app.cli(description=__doc__))
