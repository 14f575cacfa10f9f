"""How the bin in the frames is known."""

from dataclasses import dataclass

import numpy as np

from perception.bin import BinFit, Trust, check_trust
from perception.boundary import BoundarySettings, organised_points
from perception.frame import Frame, Workspace
from perception.geometry import Floats, transform_points


@dataclass(frozen=True, eq=False, kw_only=True)
class BinSettings:
    """How the bin in the frames is known, beside the pose and size that it is believed to have.

    Attributes:
        measure: Whether to measure the bin in each frame, starting from where it is believed to be.
        trust: What is corrected where a frame shows it elsewhere; see :func:`perception.bin.reconcile`.
        find: Whether to look for it in each frame, where nothing is known of its place.
        inner_size: (3,) inner length, width and height of a bin that is looked for [m]; None to measure them, too.
    """

    measure: bool = True
    trust: Trust = "camera"
    find: bool = False
    inner_size: Floats | None = None

    def __post_init__(self) -> None:
        check_trust(self.trust)


def workspace_found(frame: Frame, fit: BinFit) -> Workspace:
    """Return the bin that was found in a frame; of a table, the box over all that is measured above it.

    Args:
        frame: Frame of the camera.
        fit: Reliable fit of the bin in the frame.
    """
    if fit.inner_size is not None or fit.T_world_bin is None:
        return fit.workspace()
    v, u = np.nonzero(frame.valid)
    points_cam = organised_points(frame, np.column_stack([u, v]))
    table = Workspace(T_world_bin=fit.T_world_bin, inner_size=np.ones(3))
    points = np.abs(table.to_bin(transform_points(frame.T_world_cam, points_cam)))
    return fit.workspace(2.0 * points.max(axis=0) * (1, 1, 0.5) + 2 * BoundarySettings().margin)
