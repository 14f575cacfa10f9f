"""Speed of the cell on one core: settling, stepping, rendering, picking."""

import logging
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import get_args

import numpy as np

from binpick_env.camera.depth_camera import DepthCamera
from binpick_env.cell.settle import drop_and_settle
from binpick_env.config import CONTROL_PERIOD, Backend, SensorPreset
from binpick_env.env import BinPickEnv
from binpick_env.options import CellOptions
from perception.runtime.threads import one_core
from policies.benchmarks.measurement import Measurement, repeat, seconds
from policies.picking.scripted import ScriptedPicker

_log = logging.getLogger(__name__)
MAX_PILES = 20  # limit on the piles that the attempts are collected from
STEPS = 50  # steps per sample of the resting cell: 2 s of simulated time
_BACKENDS: tuple[Backend, ...] = get_args(Backend)


def bench_cell(options: CellOptions, count: int, seed: int, repeats: int, picks: int) -> Iterator[Measurement]:
    """Measure the cell with ``count`` parts; a row comes as soon as it is measured.

    Args:
        options: Part, bin, camera, sensor and friction.
        count: Number of parts in the bin.
        seed: Seed of the first pile; pile k of a repeated measurement has seed + k.
        repeats: Number of samples in each row, except those of picking.
        picks: Number of attempts in the rows of picking, each of which is a sample.

    Raises:
        ValueError: There is no such part, or a number is not positive.
    """
    if repeats < 1 or picks < 1:
        raise ValueError(f"repeats and picks must be at least 1, got {repeats} and {picks}")
    with one_core():
        yield from _rows(options, count, seed, repeats, picks)


def oracle_env(options: CellOptions, count: int) -> BinPickEnv:
    """Return an environment with ``count`` parts and true poses, which computes on one thread."""
    return BinPickEnv(
        options.load_part(),
        num_parts=count,
        perception="oracle",
        sensor=options.sensor,
        config=options.cell(),
        threads=1,
    )


def _rows(options: CellOptions, count: int, seed: int, repeats: int, picks: int) -> Iterator[Measurement]:
    env = oracle_env(options, count)
    try:
        yield repeat("drop and settle", "s", lambda k: _settle_seconds(env, count, seed + k), repeats)
        env.reset(seed=seed)
        yield repeat("steps of 0.04 s, pile asleep", "1/s", lambda _: _resting_steps(env), repeats)
        for backend in _BACKENDS:
            yield from _camera(env, backend, options.sensor, repeats)
        yield from _picking(env, seed, picks)
    finally:
        env.close()


def _settle_seconds(env: BinPickEnv, count: int, seed: int) -> float:
    rng = np.random.default_rng(seed)
    return seconds(lambda: drop_and_settle(env.simulation, count, rng))


def _resting_steps(env: BinPickEnv) -> float:
    action = np.append(env.simulation.target, 0.0).astype(np.float32)

    def hold() -> None:
        for _ in range(STEPS):
            env.step(action)

    return STEPS / seconds(hold)


def _camera(env: BinPickEnv, backend: Backend, sensor: SensorPreset, repeats: int) -> Iterator[Measurement]:
    """Measure one backend; without a GL driver there is no row for "egl"."""
    simulation = env.simulation
    config = replace(env.config.camera, backend=backend)
    rng = np.random.default_rng(0)
    camera: DepthCamera | None = None
    try:
        camera = DepthCamera(simulation.model, config, env.workspace, simulation.part_of_geom, threads=1)
        camera.capture(simulation.data, rng, sensor)  # compiles kernels; a missing driver shows only here
    except (RuntimeError, ImportError) as error:
        if camera is not None:
            camera.close()
        if backend != "egl":
            raise
        _log.warning("there is no row for %r: %s", backend, error)
        return
    capture = partial(camera.capture, simulation.data, rng, sensor)
    try:
        name = f"camera frame {config.width} x {config.height}, {backend}"
        yield repeat(name, "s", lambda _: seconds(capture), repeats)
    finally:
        camera.close()


def _picking(env: BinPickEnv, seed: int, picks: int) -> Iterator[Measurement]:
    picker = ScriptedPicker(env)
    env.reset(seed=seed)
    picker.pick()  # compiles kernels
    wall: list[float] = []
    steps: list[float] = []
    compute: list[float] = []
    for pile in range(seed, seed + MAX_PILES):
        env.reset(seed=pile)
        picker.reset()
        while env.remaining > 0 and not env.truncated and len(wall) < picks:
            time_before, start = env.simulation.time, time.perf_counter()
            result = picker.pick()
            taken = time.perf_counter() - start
            if result.outcome is None:
                break
            wall.append(taken)
            compute.append(result.t_compute)
            steps.append((env.simulation.time - time_before) / CONTROL_PERIOD / taken)
        if len(wall) == picks:
            break
    yield Measurement(name="attempt, wall clock", unit="s", values=tuple(wall))
    yield Measurement(name="attempts", unit="1/s", values=tuple(1 / w for w in wall))
    yield Measurement(name="attempt, of it perception and planning", unit="s", values=tuple(compute))
    yield Measurement(name="steps of 0.04 s, picking", unit="1/s", values=tuple(steps))
