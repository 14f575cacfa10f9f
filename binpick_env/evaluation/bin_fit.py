"""How well a bin is measured in frames of a camera whose pose is wrong."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from binpick_env.jobs.process_map import map_indices
from binpick_env.jobs.text_tables import columns, number
from binpick_env.jobs.workers import Workers
from binpick_env.scenes.synthesis import SceneConfig, make_scene
from perception.bin import find_bin
from perception.frame import Frame
from perception.geometry import Floats, invert_transform, make_transform, rotation_about, rotation_angle
from perception.metrics.intervals import wilson_interval

RESAMPLES = 2000  # bootstrap samples of an interval


@dataclass(frozen=True, kw_only=True)
class BinFitConfig:
    """Scenes, and how wrong the camera's pose is in each.

    Attributes:
        scenes: Configuration of the scenes.
        off_mm: Distance of the reported camera from the true one [mm]; its direction is drawn for each scene.
        off_deg: Angle between the two [deg], about an axis through the camera that is drawn for each scene.
    """

    scenes: SceneConfig
    off_mm: float = 10.0
    off_deg: float = 2.0

    def __post_init__(self) -> None:
        for name in ("off_mm", "off_deg"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be 0 or more and finite, got {getattr(self, name)}")


@dataclass(frozen=True, kw_only=True)
class BinTrial:
    """What was measured in one scene.

    Attributes:
        index: Index of the scene.
        reason: Why the fit is not reliable; None if it is.
        believed_mm: Distance of the true bin from the believed one, as the camera sees them [mm].
        error_mm: Distance of the measured bin from the true one [mm]; None for a fit that is not reliable.
        error_deg: Angle between the two [deg]; None likewise.
        ms: Processor time [ms].
    """

    index: int
    reason: str | None
    believed_mm: float
    error_mm: float | None
    error_deg: float | None
    ms: float


def measure_bins(config: BinFitConfig, count: int, workers: Workers) -> Iterator[BinTrial]:
    """Yield the trials of scenes 0 to ``count - 1``, in order of completion.

    Args:
        config: Scenes and errors of the camera's pose.
        count: Number of scenes.
        workers: Number of worker processes, or a cluster.

    Raises:
        ValueError: ``count`` or ``workers`` is not positive.
        WorkerError: A process was killed.
    """
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    yield from map_indices(partial(measure_bin, config), range(count), workers)


def measure_bin(config: BinFitConfig, index: int) -> BinTrial:
    """Return the trial of scene ``index``, which depends on nothing else."""
    frame = make_scene(config.scenes, index).capture.frame
    workspace = config.scenes.cell().bin.workspace()
    rng = np.random.default_rng(np.random.SeedSequence([config.scenes.seed, index, 1]))
    direction, axis = rng.normal(size=3), rng.normal(size=3)
    T_cam_reported = make_transform(
        rotation_about(axis, float(np.deg2rad(config.off_deg))),
        config.off_mm / 1000 * direction / np.linalg.norm(direction),
    )
    T_cam_bin = invert_transform(frame.T_world_cam) @ workspace.T_world_bin
    reported = Frame(grey=frame.grey, depth=frame.depth, K=frame.K, T_world_cam=frame.T_world_cam @ T_cam_reported)
    if index == 0:
        find_bin(reported, workspace.inner_size, workspace)  # the first call imports and allocates
    started = time.process_time()
    fit = find_bin(reported, workspace.inner_size, workspace)
    ms = 1000 * (time.process_time() - started)
    T_reported_world = invert_transform(reported.T_world_cam)
    believed_mm, _ = _difference(T_cam_bin, T_reported_world @ workspace.T_world_bin)
    if not fit.reliable or fit.T_world_bin is None:
        return BinTrial(index=index, reason=fit.reason, believed_mm=believed_mm, error_mm=None, error_deg=None, ms=ms)
    error_mm, error_deg = _difference(T_cam_bin, T_reported_world @ fit.T_world_bin)
    return BinTrial(index=index, reason=None, believed_mm=believed_mm, error_mm=error_mm, error_deg=error_deg, ms=ms)


def bin_fit_table(trials: Sequence[BinTrial]) -> str:
    """Return the table of trials, with 95 % intervals: Wilson's for the share, bootstrapped over scenes otherwise."""
    found = [trial for trial in trials if trial.reason is None]
    low, high = wilson_interval(len(found), len(trials))
    share = f"{len(found)}/{len(trials)} = {len(found) / len(trials):.1%} ({low:.1%} to {high:.1%})"
    lines = [f"reliable fits: {share.replace('%', ' %')}"]
    rows = [("", "median", "95 %", "largest")]
    for name, values, digits in (
        ("believed off [mm]", [trial.believed_mm for trial in trials], 1),
        ("position error [mm]", [trial.error_mm for trial in found if trial.error_mm is not None], 2),
        ("rotation error [deg]", [trial.error_deg for trial in found if trial.error_deg is not None], 3),
        ("processor time [ms]", [trial.ms for trial in trials], 1),
    ):
        rows.append((name, *_quantiles(np.array(values), digits)))
    lines.append(columns(rows))
    lines += [f"scene {trial.index}: {trial.reason}" for trial in trials if trial.reason is not None]
    return "\n".join(lines)


def _quantiles(values: NDArray[np.float64], digits: int) -> tuple[str, str, str]:
    """Return median and 95 % quantile of (N,) values with their intervals, and the largest value."""
    if len(values) == 0:
        return (number(None, digits),) * 3
    samples = np.random.default_rng(0).choice(values, (RESAMPLES, len(values)))
    cells = []
    for share in (0.5, 0.95):
        low, high = np.quantile(np.quantile(samples, share, axis=1), (0.025, 0.975))
        cells.append(f"{np.quantile(values, share):.{digits}f} ({low:.{digits}f} to {high:.{digits}f})")
    return cells[0], cells[1], number(float(values.max()), digits)


def _difference(T_cam_a: Floats, T_cam_b: Floats) -> tuple[float, float]:
    """Return distance [mm] and angle [deg] of two (4, 4) poses."""
    T_a_b = invert_transform(T_cam_a) @ T_cam_b
    return 1000 * float(np.linalg.norm(T_a_b[:3, 3])), float(np.degrees(rotation_angle(T_a_b[:3, :3])))
