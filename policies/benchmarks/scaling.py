"""How the time and the memory of a frame grow with the number of parts in the bin, and with that of pixels."""

import multiprocessing
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from binpick_env.options import CellOptions
from perception.frame import Frame, Workspace
from perception.pipeline import Pipeline
from perception.runtime.threads import one_core
from policies.benchmarks.builds.worker import peak_memory
from policies.benchmarks.cell import oracle_env
from policies.benchmarks.measurement import Measurement


@dataclass(frozen=True, kw_only=True)
class Steps:
    """What is varied, each about the same frame.

    Attributes:
        counts: Numbers of parts in the bin, at the width of the options.
        count: Number of parts at every width.
        widths: Widths of the image [px], whose height follows.
    """

    counts: tuple[int, ...]
    count: int
    widths: tuple[int, ...]

    def __post_init__(self) -> None:
        for name, values in (("counts", self.counts), ("count", (self.count,)), ("widths", self.widths)):
            if not values or min(values) < 1:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")


class _Frames(NamedTuple):
    """What was measured at one number of parts and one size."""

    milliseconds: tuple[float, ...]
    megabytes: float  # growth of the peak memory over the frames


def bench_scaling(options: CellOptions, steps: Steps, seed: int, repeats: int) -> Iterator[Measurement]:
    """Measure frames to poses on one core; each row is yielded as it is measured.

    Args:
        options: Part, bin, camera, sensor and friction.
        steps: Numbers of parts and of pixels.
        seed: Seed of the first pile; pile k has seed + k.
        repeats: Number of piles, and frames, of each row.

    Raises:
        ValueError: There is no such part, a number is not positive, or the bin does not hold so many parts.
    """
    if repeats < 1:
        raise ValueError(f"repeats must be at least 1, got {repeats}")
    shape = options.height / options.width
    series = {
        "parts": [(count, options.width) for count in steps.counts],
        "pixels": [(steps.count, width) for width in steps.widths],
    }
    done: dict[tuple[int, int], _Frames] = {}
    for case in dict.fromkeys(series["parts"] + series["pixels"]):
        count, width = case
        cell = replace(options, width=width, height=round(shape * width))
        done[case] = _measure(cell, count, seed, repeats)
        name = f"{count} parts, {width * cell.height / 1e6:.2g} megapixels"
        yield Measurement(name=f"{name}: frame", unit="ms", values=done[case].milliseconds)
        yield Measurement(name=f"{name}: memory", unit="MB", values=(done[case].megabytes,))
    for what, cases in series.items():
        if len(cases) > 1:
            sizes = [count if what == "parts" else width**2 for count, width in cases]
            yield _slope(f"time over {what}", sizes, [done[case].milliseconds for case in cases])
            yield _slope(f"memory over {what}", sizes, [(done[case].megabytes,) for case in cases])


def _slope(name: str, sizes: Sequence[int], values: Sequence[tuple[float, ...]]) -> Measurement:
    """Return the exponent of the power of the size that the medians grow with."""
    medians = [max(float(np.median(each)), 1e-9) for each in values]
    exponent = float(np.polyfit(np.log(sizes), np.log(medians), 1)[0])
    return Measurement(name=f"{name}: exponent", unit="1", values=(exponent,))


def _measure(options: CellOptions, count: int, seed: int, repeats: int) -> _Frames:
    """Make frames, and perceive them in a new process, whose memory holds nothing else."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frames.npz"
        with one_core():
            _save_frames(path, options, count, seed, repeats)
            with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
                return process.submit(_perceive, path, options, repeats).result()


def _save_frames(path: Path, options: CellOptions, count: int, seed: int, repeats: int) -> None:
    env = oracle_env(options, count)
    arrays: dict[str, Any] = {"T_world_bin": env.workspace.T_world_bin, "inner_size": env.workspace.inner_size}
    for k in range(repeats):
        env.reset(seed=seed + k)
        frame = env.frame
        arrays |= {f"grey_{k}": frame.grey, f"depth_{k}": frame.depth, f"pose_{k}": frame.T_world_cam, "K": frame.K}
    env.close()
    np.savez(path, allow_pickle=False, **arrays)


def _perceive(path: Path, options: CellOptions, repeats: int) -> _Frames:
    """Perceive each frame once; the first one also before, which compiles kernels."""
    with np.load(path) as given:
        workspace = Workspace(T_world_bin=given["T_world_bin"], inner_size=given["inner_size"])
        frames = [
            Frame(grey=given[f"grey_{k}"], depth=given[f"depth_{k}"], K=given["K"], T_world_cam=given[f"pose_{k}"])
            for k in range(repeats)
        ]
    pipeline = Pipeline.for_part(options.load_part().model, workspace)
    ready = peak_memory()
    pipeline.perceive(frames[0])
    times = []
    for frame in frames:
        started = time.process_time()  # on one core that of a quiet machine is the wall clock
        pipeline.perceive(frame)
        times.append(1000 * (time.process_time() - started))
    return _Frames(milliseconds=tuple(times), megabytes=peak_memory() - ready)
