"""The level on which a bin ends, wherever its stated height puts the floor."""

import numpy as np

from perception.bin.cloud import GridCloud
from perception.bin.planes import peaks
from perception.bin.refinement import BinState
from perception.geometry import Floats, invert_transform, transform_points

OTHER_HEIGHT = 0.01  # distance below the stated floor beyond which a level is the floor [m]
_CELL = 0.01  # side of the cells whose lowest points are looked at [m]
_RIM = 0.01  # depth below the rim down to which no floor is looked for [m]
_ASIDE = 0.003  # distance beyond the walls within which points count, and from them within which no floor is looked for
_FEWEST_CELLS = 15  # number of cells in which a floor is seen
_FEWEST_IN_QUARTER = 3  # number of a floor's cells in each of three quarters of the bin: it lies all over it
_RAISED_SHARE = 0.1  # least share of the cells on a level that is higher than stated: the floor below may be hidden
_LOWER_SHARE = 0.01  # largest share of the measurements below a floor
_ABOVE_SHARE = 0.5  # largest ratio of the cells just above a floor and on it: a pile has no such step


def lowest_level(cloud: GridCloud, state: BinState, *, floor_seen: bool) -> float | None:
    """Return the height of the lowest level in a bin above its stated floor [m]; None if there is none.

    Nothing is measured below a floor. It lies all over the bin, and nothing ends just above it. A level that is lower
    than stated has more points than the stated one.

    Args:
        cloud: Points of the frame.
        state: The bin, whose rim was found.
        floor_seen: Whether a level near the stated height was taken for the floor; then only a lower one is returned.
    """
    p = transform_points(invert_transform(state.T_cam_bin), cloud.points_cam)
    half = state.size[:2] / 2
    beside = np.maximum(np.abs(p[:, 0]) - half[0], np.abs(p[:, 1]) - half[1])
    within = (beside <= _ASIDE) & (p[:, 2] < state.size[2] + state.lift - _RIM)
    if floor_seen and np.count_nonzero(within & (p[:, 2] < -OTHER_HEIGHT)) < _FEWEST_CELLS:
        return None
    lowest = _lowest_in_cells(p[within & (beside < -_ASIDE)], half)
    if len(lowest) < _FEWEST_CELLS:
        return None
    heights = lowest[:, 2] + 2 * state.noise  # the least of some ten measurements lies about this low
    width = max(0.001, state.noise)
    for level in np.sort(peaks(heights, width, _FEWEST_CELLS / len(heights))).tolist():
        on = np.abs(heights - level) <= 1.5 * width
        above = (heights > level + 1.5 * width) & (heights <= level + 4.5 * width)
        quarters = np.bincount(2 * (lowest[on, 0] > 0) + (lowest[on, 1] > 0), minlength=4)
        spread = np.count_nonzero(quarters >= _FEWEST_IN_QUARTER) >= 3
        if spread and np.count_nonzero(above) <= _ABOVE_SHARE * np.count_nonzero(on):
            gate = max(0.003, 4 * state.noise)
            z = p[within, 2]
            if np.mean(z < level - gate) > _LOWER_SHARE:
                return None
            if level > 0:
                return None if floor_seen or np.mean(on) < _RAISED_SHARE else level
            # Through a perforated floor, what it stands on is seen, too, but less of it.
            more = np.count_nonzero(np.abs(z - level) <= gate) > np.count_nonzero(np.abs(z) <= gate)
            return level if more else None
    return None


def _lowest_in_cells(points_bin: Floats, half: Floats) -> Floats:
    """Return the lowest of (N, 3) points in each cell of the bin."""
    cells = np.floor((points_bin[:, :2] + half) / _CELL).astype(np.int64)
    index = cells[:, 0] * (int(cells[:, 1].max(initial=0)) + 1) + cells[:, 1]
    order = np.lexsort((points_bin[:, 2], index))
    lowest: Floats = points_bin[order[np.flatnonzero(np.diff(index[order], prepend=-1))]]
    return lowest
