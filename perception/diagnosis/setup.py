"""What is assumed of camera and bin in a diagnosis."""

from dataclasses import dataclass

import numpy as np

from perception.diagnosis.samples import BoxFit, DepthSamples
from perception.frame import Frame, Workspace
from perception.geometry import Floats, invert_transform


@dataclass(frozen=True, eq=False, kw_only=True)
class Setup:
    """What is assumed of camera and bin, and corrected cause by cause.

    Attributes:
        K: (3, 3) camera matrix [px].
        T_world_cam: (4, 4) camera pose.
        T_world_bin: (4, 4) pose of the bin.
        inner_size: (3,) inner length, width and height of the bin [m].
        scale: Factor from the frame's depth to metres.
    """

    K: Floats
    T_world_cam: Floats
    T_world_bin: Floats
    inner_size: Floats
    scale: float = 1.0

    @classmethod
    def of(cls, frame: Frame, workspace: Workspace) -> "Setup":
        """Return what a frame and a bin state."""
        return cls(
            K=np.asarray(frame.K, np.float64),
            T_world_cam=np.asarray(frame.T_world_cam, np.float64),
            T_world_bin=np.asarray(workspace.T_world_bin, np.float64),
            inner_size=np.asarray(workspace.inner_size, np.float64),
        )

    @property
    def T_cam_bin(self) -> Floats:
        """(4, 4) pose of the bin in the camera frame."""
        T: Floats = invert_transform(self.T_world_cam) @ self.T_world_bin
        return T

    def fit(self, samples: DepthSamples) -> BoxFit:
        """Return how well the measurements fill the bin."""
        return samples.fit(self.K, self.T_cam_bin, self.inner_size, self.scale)
