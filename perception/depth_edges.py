"""Edges of a depth image: steps from one surface to another, and creases of one surface."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from perception import _depth_edge_kernels as _kernels
from perception.geometry import Floats

_LAG = 3  # distance of the depths whose second difference tells the noise [px]
_LINES = 100  # number of rows and columns that noise is measured in
_MEDIAN = 0.6745  # median absolute value of a standard normal number
_FEWEST_SHARE = 0.01  # share of the depths with a second difference below which another distance is tried
_STEP_SAMPLES = 4096  # number of depths that tell the step of rounded ones
_FEWEST_LEVELS = 8  # number of different depths with which these are no few flat faces
_LEAST_STEP = 1e-5  # step below which depths count as not rounded, as a share of their median


@dataclass(frozen=True, kw_only=True)
class DepthEdgeSettings:
    """Settings of the depth edges."""

    step: float = 0.0006  # smallest depth step [m]
    jump: float = 4.0  # slope of a surface that no longer explains the step of two neighbours, as a tangent
    crease: float = float(np.deg2rad(25.0))  # smallest angle of a crease, in the plane of a row or a column [rad]
    certainty: float = 5.0  # smallest step and crease in standard deviations of the depth's noise
    reach: tuple[int, int] = (5, 14)  # fewest and most pixels on each side that are compared; noise asks for more
    shortest: int = 10  # edges of fewer connected pixels are noise [px]

    def __post_init__(self) -> None:
        for name in ("step", "jump", "crease", "certainty"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if not _kernels.FEWEST <= self.reach[0] <= self.reach[1]:
            raise ValueError(f"reach must be (fewest, most) pixels from {_kernels.FEWEST} up, got {self.reach}")
        if self.shortest < 1:
            raise ValueError(f"shortest must be at least 1 px, got {self.shortest}")


def depth_edges(depth: NDArray[np.float32], K: Floats, settings: DepthEdgeSettings | None = None) -> NDArray[np.bool_]:
    """Return the (H, W) mask of the depth edges; those of a step lie on the near side.

    A step is a difference of depth that neither the noise nor the slope of the surfaces explains. A crease is a change
    of the normal over a window, which is the wider the noisier the depth is. Both are looked for along rows and along
    columns. The noise is measured in the image itself.

    Args:
        depth: (H, W) float32 depth [m], 0 where there is no measurement.
        K: (3, 3) camera matrix [px].
        settings: Thresholds; the defaults of :class:`DepthEdgeSettings` if None.

    Note:
        Deterministic.
    """
    settings = settings or DepthEdgeSettings()
    found = np.zeros(depth.shape, np.bool_)
    step = max(min(depth.shape) // _LINES, 1)
    sample = depth[::step, ::step]
    if not sample.any():
        return found
    middle = float(np.median(sample[sample > 0]))
    for turned, focal in ((False, float(K[0, 0])), (True, float(K[1, 1]))):
        image = np.ascontiguousarray(depth.T if turned else depth)
        limit = max(2 * settings.certainty * depth_noise(image[::step]), settings.jump / focal / middle)
        smooth = _kernels.mean_of_three(image, limit)
        lines = np.ascontiguousarray(smooth[::step])
        noise = depth_noise(lines)
        reach = _reach(noise * middle * focal, settings)
        # Neighbours' errors are often alike: then lines deviate by more than the noise of a pixel explains.
        deviations = _kernels.row_deviations(lines, focal, noise, reach, settings.jump)
        excess = np.maximum(np.median(deviations, axis=0) / _MEDIAN, 1.0) if len(deviations) else np.ones(2)
        edges = _kernels.row_edges(
            smooth,
            focal,
            noise,
            reach,
            settings.jump,
            settings.step,
            settings.crease,
            *(settings.certainty * excess).tolist(),
        )
        found |= edges.T if turned else edges
    return _without_specks(found, settings.shortest)


def depth_noise(depth: NDArray[np.float32], lag: int = _LAG) -> float:
    """Return the standard deviation of a depth image's noise at 1 m, growing with the square of the depth [m].

    It is the median absolute second difference along the rows, in terms of normal noise; 0 where too little is
    measured. Curved surfaces and edges hardly count, because most of an image is flat at this scale.

    Args:
        depth: (H, W) depth [m], 0 where there is no measurement.
        lag: Distance of the depths whose second difference is taken [px]. Where the errors of neighbours are alike, a
            larger one tells more of the noise, but curved surfaces count more, too. Where columns are missing
            regularly, so that hardly any depths have this distance, the nearest one that more of them have is taken.
    """
    second = _second_differences(depth, lag)
    fewest = _FEWEST_SHARE * np.count_nonzero(depth)
    if len(second) < fewest:
        others = (each for each in range(1, 2 * lag + 1) if each != lag)
        for other in sorted(others, key=lambda each: abs(each - lag)):
            more = _second_differences(depth, other)
            if len(more) > len(second):
                second = more
            if len(second) >= fewest:
                break
    return float(np.median(second) / (_MEDIAN * np.sqrt(6.0))) if len(second) else 0.0


def _second_differences(depth: NDArray[np.float32], lag: int) -> NDArray[np.float32]:
    """Return the (N,) absolute second differences of depths ``lag`` pixels apart, as shares of the squared depths."""
    before, here, after = depth[:, : -2 * lag], depth[:, lag:-lag], depth[:, 2 * lag :]
    valid = (before > 0) & (here > 0) & (after > 0)
    second: NDArray[np.float32] = np.abs(before[valid] - 2 * here[valid] + after[valid]) / here[valid] ** 2
    return second


def depth_std(depth: NDArray[np.float32], lag: int = _LAG) -> float:
    """Return the standard deviation of a depth image's noise at its median depth, in the unit of the depth.

    It is at least that of the rounding, where the depths are multiples of a step, and 0 where too little is measured.
    The arguments are those of :func:`depth_noise`.
    """
    measured = depth[depth > 0]
    if len(measured) == 0:
        return 0.0
    # Steps are wider than the noise where most second differences are 0: then only the steps tell.
    return max(depth_noise(depth, lag) * float(np.median(measured)) ** 2, depth_step(measured) / float(np.sqrt(12.0)))


def depth_step(measured: NDArray[np.float32]) -> float:
    """Return the step that depths are multiples of, in their unit; 0 if there is none, or it grows with the depth.

    Args:
        measured: (N,) depths.
    """
    some = measured[:: max(len(measured) // _STEP_SAMPLES, 1)]
    levels = np.unique(some).astype(np.float64)
    if len(levels) < _FEWEST_LEVELS:
        return 0.0
    rounding = 3 * float(np.finfo(np.float32).eps) * float(levels[-1])
    gaps = np.diff(levels)
    gaps = gaps[gaps > rounding]
    if len(gaps) + 1 < _FEWEST_LEVELS or gaps.min() < _LEAST_STEP * np.median(levels):
        return 0.0
    multiples = np.rint(gaps / gaps.min())
    step = float(gaps.sum() / multiples.sum())
    uneven = np.any(np.abs(gaps - step * multiples) > rounding)
    return 0.0 if uneven or np.mean(multiples == 1) < 0.5 else step


def sampled_rows(depth: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Return every ``step``-th row of an (H, W) depth image, from the first row on with which any depth is measured.

    Args:
        depth: (H, W) depth, 0 where there is no measurement. Whole rows may be missing regularly.
        step: Distance of the rows [px].
    """
    rows = (depth[first::step] for first in range(min(step, len(depth))))
    return next((some for some in rows if some.any()), depth[::step])


def _reach(noise: float, settings: DepthEdgeSettings) -> int:
    """Return the number of pixels on each side with which a crease of the smallest angle is certain.

    The slope of a line through n points has the variance 12 sigma^2 / n^3.

    Args:
        noise: Standard deviation of the depth in widths of a pixel.
        settings: Thresholds.
    """
    wanted = (24 * (settings.certainty * noise / np.tan(settings.crease)) ** 2) ** (1 / 3)
    return int(np.clip(np.ceil(wanted), *settings.reach))


def _without_specks(edges: NDArray[np.bool_], shortest: int) -> NDArray[np.bool_]:
    """Return the edges of at least ``shortest`` pixels; noise leaves gaps of a pixel or two in an edge."""
    joined = cv2.dilate(edges.astype(np.uint8), np.ones((3, 3), np.uint8))
    count, labels = cv2.connectedComponents(joined, connectivity=8)
    long_enough = np.bincount(labels[edges], minlength=count) >= shortest
    kept: NDArray[np.bool_] = edges & long_enough[labels]
    return kept
