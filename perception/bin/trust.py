"""What is corrected where camera and bin disagree: the bin's pose, or the camera's."""

from dataclasses import replace
from typing import Literal, get_args

from perception.bin.bin_fit import BinFit
from perception.frame import Frame, Workspace
from perception.geometry import invert_transform

Trust = Literal["camera", "bin"]


def check_trust(trust: str) -> None:
    """Raise ``ValueError`` unless ``trust`` is one of `Trust`."""
    if trust not in get_args(Trust):
        raise ValueError(f"trust must be one of {', '.join(get_args(Trust))}, got {trust!r}")


def reconcile(frame: Frame, workspace: Workspace, fit: BinFit, trust: Trust) -> tuple[Frame, Workspace]:
    """Return a frame and its bin so that the bin stands where the frame shows it; unchanged if the fit is unreliable.

    Args:
        frame: Frame of the camera.
        workspace: The bin as it is believed to be.
        fit: The bin as the frame shows it.
        trust: "camera" if the camera's pose is right and the bin may have moved; "bin" if the bin stands where it is
            said to be, as in a fixture that the robot knows, and the camera's pose is to be corrected.

    Raises:
        ValueError: ``trust`` is neither of the two.
    """
    check_trust(trust)
    if not fit.reliable or fit.T_world_bin is None:
        return frame, workspace
    if trust == "camera":
        return frame, replace(workspace, T_world_bin=fit.T_world_bin)
    T_bin_cam = invert_transform(fit.T_world_bin) @ frame.T_world_cam
    return replace(frame, T_world_cam=workspace.T_world_bin @ T_bin_cam), workspace
