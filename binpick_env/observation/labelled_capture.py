"""A capture with the truth beside it: what a perceiver is shown."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from binpick_env.camera.depth_camera import Capture
from perception.frame import Workspace
from perception.geometry import Floats, invert_transform
from perception.part import PartModel


@dataclass(frozen=True, eq=False, kw_only=True)
class LabelledCapture:
    """One capture of the bin, with the ground truth for the perceivers that are allowed to read it.

    Attributes:
        capture: Frame and true instance ids.
        workspace: Pose and inner box of the bin.
        part: Model of the parts in the bin.
        T_world_parts: (N, 4, 4) true poses of the parts.
        visible_fractions: (N,) true visible fractions, 0 for parts out of play.
        hand_eye: (3,) offset from the camera's true position to its reported one, world axes [m]; where the frame's
            orientation is not the true one, its pose counts instead.
    """

    capture: Capture
    workspace: Workspace
    part: PartModel
    T_world_parts: Floats
    visible_fractions: NDArray[np.float64]
    hand_eye: Floats = field(default_factory=lambda: np.zeros(3))

    @cached_property
    def T_reported_parts(self) -> Floats:
        """(N, 4, 4) part poses as seen from the camera's reported pose, the best that perception can know."""
        reported, true = self.capture.frame.T_world_cam, self.capture.T_world_cam
        if not np.array_equal(reported[:3, :3], true[:3, :3]):
            T_reported_true = reported @ invert_transform(true)
            return np.asarray(T_reported_true @ self.T_world_parts, np.float64)
        moved = self.T_world_parts.copy()
        moved[:, :3, 3] += self.hand_eye
        return moved
