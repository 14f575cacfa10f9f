"""Speed of gathering experience: attempts per second in the full and the fast simulation, in many processes."""

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from binpick_env.jobs.process_map import map_indices
from binpick_env.options import CellOptions
from policies.benchmarks.measurement import Measurement
from policies.selection.env import GraspSelectionEnv
from policies.selection.selectors import WeightedSelector

MODES: dict[str, tuple[bool, tuple[int, int] | None]] = {  # whether fast, and the image's size unless the cell's [px]
    "in full": (False, None),
    "fast": (True, None),
    "fast, 640 x 480 pixels": (True, (640, 480)),
}


def bench_selection(
    options: CellOptions, seed: int, picks: int, workers: int, perception: str = "oracle"
) -> Iterator[Measurement]:
    """Measure attempts per second of all processes together; each row is yielded as it is measured.

    Args:
        options: Part, bin, jaw, camera, sensor and friction.
        seed: Seed of the first pile of the first process.
        picks: Number of attempts per process; the time includes settling new piles, but no compilation.
        workers: Number of processes with one core each; each is a sample.
        perception: Source of the poses, as in `BinPickSelect-v0`.

    Raises:
        ValueError: There is no such part, or a number is not positive.
    """
    if picks < 1 or workers < 1:
        raise ValueError(f"picks and workers must be at least 1, got {picks} and {workers}")
    for name, (fast, size) in MODES.items():
        cell = options if size is None else replace(options, width=size[0], height=size[1])
        arguments = {
            "part": cell.part,
            "unit": cell.unit,
            "symmetry": cell.symmetry,
            "density": cell.density,
            "symmetry_tolerance": cell.symmetry_tolerance,
            "sensor": cell.sensor,
            "config": cell.cell(),
            "perception": perception,
            "threads": 1,
            "fast": fast,
        }
        times = list(map_indices(partial(_seconds, arguments, seed, picks), range(workers), workers))
        each = tuple(picks / taken for taken in times)
        yield Measurement(name=f"attempts of a process, {name}", unit="1/s", values=each)
        yield Measurement(name=f"attempts of {workers} processes, {name}", unit="1/s", values=(sum(each),))


def _seconds(arguments: dict[str, Any], seed: int, picks: int, index: int) -> float:
    """Return the wall clock time of ``picks`` attempts of the weighted heuristic [s]."""
    env = GraspSelectionEnv(**arguments)
    selector, rng = WeightedSelector(), np.random.default_rng(0)
    observation, _ = env.reset(seed=seed + 1000 * index)
    if observation["mask"].any():
        env.step(np.int64(selector.select(observation, rng)))  # compiles kernels
    started, made, pile = time.perf_counter(), 0, seed + 1000 * index
    over = True
    while made < picks:
        if over:
            pile += 1
            observation, _ = env.reset(seed=pile)
        row = selector.select(observation, rng) if observation["mask"].any() else 0
        observation, _, terminated, truncated, _ = env.step(np.int64(row))
        over = terminated or truncated
        made += env.result is not None
    taken = time.perf_counter() - started
    env.close()
    return taken
