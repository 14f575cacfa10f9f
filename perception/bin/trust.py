"""What is corrected where camera and bin disagree: the bin's pose, or the camera's."""

from dataclasses import replace

import numpy as np

from perception.bin.bin_fit import BinFit
from perception.bin.choices import Trust, check_trust
from perception.bin.height import OTHER_HEIGHT
from perception.frame import Frame, Workspace
from perception.geometry import invert_transform

UNSEEN_STD = 0.005, 0.026  # standard deviations of a pose that could not be measured [m], [rad]: 5 mm, 1.5 degrees


def reconcile(frame: Frame, workspace: Workspace, fit: BinFit, trust: Trust) -> tuple[Frame, Workspace]:
    """Return a frame and its bin so that the bin stands where the frame shows it.

    The bin returned has the uncertainty of the fit, and its height where the floor was measured more than a centimetre
    below where the believed height puts it. If the fit is unreliable, the poses stay as they are, and the bin's
    is uncertain by 5 mm and 1.5 degrees.

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
        translation_std, rotation_std = UNSEEN_STD
        return frame, replace(workspace, translation_std=translation_std, rotation_std=rotation_std)
    size = workspace.inner_size
    if fit.inner_size is not None and abs(fit.inner_size[2] - size[2]) > OTHER_HEIGHT:
        size = np.array([*size[:2], fit.inner_size[2]])
    measured = replace(workspace, inner_size=size, translation_std=fit.translation_std, rotation_std=fit.rotation_std)
    if trust == "camera":
        return frame, replace(measured, T_world_bin=fit.T_world_bin)
    T_bin_cam = invert_transform(fit.T_world_bin) @ frame.T_world_cam
    return replace(frame, T_world_cam=workspace.T_world_bin @ T_bin_cam), measured
