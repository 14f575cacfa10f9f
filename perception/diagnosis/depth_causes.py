"""Depth that is too noisy or has too many holes for the poses: suspected where few groups have a verified pose."""

import numpy as np
from numpy.typing import NDArray

from perception.depth_edges import depth_std, depth_step, sampled_rows
from perception.diagnosis.report import Cause, PoseCounts

_NOISE_LAG = 8  # distance of the depths that tell the noise, over which neighbours' errors differ [px]
_NOISE_ROWS = 8  # every such row tells the noise
_NOISE, _NOISE_SHARE = 0.0025, 0.05  # noise from which scores lose much, in metres and as a share of d_max
_STEP = 0.003  # the same of the step of rounded depth [m]
_FEW = 0.5  # share of the groups with a verified pose below which poses are lost
_SPARSE = 0.3  # share of the pixels with depth below which most edges and surfaces are missing
_PERIODS = range(2, 9)  # distances of regularly missing rows or columns that are looked for [px]
_MISSING = 0.1  # largest share of the measurements in a missing row, compared with the fullest ones


def few_found(poses: PoseCounts | None) -> bool:
    """Return whether fewer than half of the groups have a verified pose, or there are none."""
    return poses is not None and (poses.groups == 0 or poses.found < _FEW * poses.groups)


def noise_cause(depth: NDArray[np.float32], scale: float, d_max: float, poses: PoseCounts | None) -> list[Cause]:
    """Suspect the noise of the depth if it is large and few groups have a verified pose.

    Args:
        depth: (H, W) depth of the bin's region, 0 where there is no measurement.
        scale: Length of one unit of it [m].
        d_max: Largest extent of the part [m].
        poses: What became of the groups in the pose estimation; None if there was none.
    """
    if not few_found(poses):
        return []
    rows = sampled_rows(depth, _NOISE_ROWS)
    step, noise = depth_step(rows[rows > 0]) * scale, depth_std(rows, _NOISE_LAG) * scale
    if step < _STEP and noise < min(_NOISE, _NOISE_SHARE * d_max):
        return []
    if step >= _STEP:
        what = f"the depth has steps of {1000 * step:.2g} mm"
        todo = "store it in finer units (tenths of a millimetre, or floating point)"
    else:
        what = f"the noise of the depth is {1000 * noise:.2g} mm, {100 * noise / d_max:.2g} % of the part's extent"
        todo = "average several frames, filter the depth, move the camera nearer, or change the exposure"
    text = f"{what}, and few groups have a verified pose: scores and accuracy of the poses suffer from it; {todo}"
    return [Cause(name="depth_noise", text=text)]


def sparse_cause(depth: NDArray[np.float32], poses: PoseCounts | None) -> list[Cause]:
    """Suspect the holes of the depth if few groups have a verified pose, and rows, columns or most pixels are missing.

    Args:
        depth: (H, W) depth of the bin's region, 0 where there is no measurement.
        poses: What became of the groups in the pose estimation; None if there was none.
    """
    if not few_found(poses) or not depth.any():
        return []
    there = depth > 0
    share = float(there.mean())
    pattern = [
        f"{missing} of every {period} {lines} are missing"
        for lines, axis in (("rows", 1), ("columns", 0))
        for missing, period in [_regular_gaps(there.mean(axis=axis))]
        if missing
    ]
    if not pattern and share >= _SPARSE:
        return []
    said = f"; {' and '.join(pattern)}" if pattern else ""
    todo = (
        "fill them, or make the image smaller by this factor and adapt K"
        if pattern
        else "check exposure and range of the depth camera, what shines or absorbs light, and its filters"
    )
    text = (
        f"only {100 * share:.0f} % of the pixels around the bin have a depth{said}: edges and surfaces are lost; {todo}"
    )
    return [Cause(name="sparse_depth", text=text)]


def _regular_gaps(shares: NDArray[np.float64]) -> tuple[int, int]:
    """Return how many of every how many lines are missing, given the (N,) shares of pixels measured in them; 0 if none.

    Args:
        shares: (N,) shares of the pixels of each row, or of each column, that have a depth.
    """
    for period in _PERIODS:
        if len(shares) < 4 * period:
            break
        phases = np.array([shares[first::period].mean() for first in range(period)])
        missing = int(np.count_nonzero(phases <= _MISSING * phases.max()))
        if missing:
            return missing, period
    return 0, 1
