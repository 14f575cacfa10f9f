"""A camera's reported pose, corrected by the bin in its frame."""

from dataclasses import replace

from binpick_env.camera.depth_camera import Capture
from perception.bin import find_bin, reconcile
from perception.frame import Workspace


def correct_by_bin(capture: Capture, workspace: Workspace) -> Capture:
    """Return a capture whose frame states the camera pose by which it sees the bin where the bin stands.

    Args:
        capture: Capture of a camera whose reported pose may be wrong; it is returned as it is if the bin is not seen.
        workspace: Pose and inner box of the bin.
    """
    fit = find_bin(capture.frame, workspace.inner_size, workspace)
    return replace(capture, frame=reconcile(capture.frame, workspace, fit, "bin")[0])
