"""Canny breaks ties to the left and up: how much the boundary points of a mirrored frame differ."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception.boundary import BoundarySettings, BoundarySource, extract_boundary
from perception.frame import Frame
from tests.perception.block_scene import BIN, POSES, photographed

FRAME = photographed(*POSES)


def mirrored(frame: Frame) -> Frame:
    """Return what the camera sees of the mirrored scene; the bin, centred below the camera, is the same."""
    K = frame.K.copy()
    K[0, 2] = frame.depth.shape[1] - 1 - K[0, 2]
    grey, depth = (np.ascontiguousarray(image[:, ::-1]) for image in (frame.grey, frame.depth))
    return Frame(grey=grey, depth=depth, K=K, T_world_cam=frame.T_world_cam)


def away(a: NDArray[np.generic], b: NDArray[np.generic]) -> NDArray[np.float64]:
    """Return the distance of each of ``a`` to the nearest of ``b``."""
    return np.asarray(cKDTree(b).query(a)[0])


@pytest.mark.parametrize("source", ["grey", "depth", "both"])
def test_a_mirrored_frame_has_nearly_the_mirrored_points(source: BoundarySource) -> None:
    settings = BoundarySettings(source=source)
    cloud, other = (extract_boundary(frame, BIN, settings) for frame in (FRAME, mirrored(FRAME)))
    back = np.column_stack([FRAME.depth.shape[1] - 1 - other.pixels[:, 0], other.pixels[:, 1]])
    points_back = other.points_cam * (-1, 1, 1)
    assert len(cloud) > 400
    for a, b in ((cloud.pixels, back), (back, cloud.pixels)):
        assert np.mean(away(a, b) > 1) < 0.01
    for a, b in ((cloud.points_cam, points_back), (points_back, cloud.points_cam)):
        assert np.mean(away(a, b)) < 0.0001
        assert np.mean(away(a, b) > 0.001) < 0.01
