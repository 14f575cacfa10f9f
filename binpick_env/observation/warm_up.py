"""JIT warm-up: a small capture for the first calls of the kernels, which compile or load them."""

from dataclasses import replace

import mujoco
import numpy as np

from binpick_env.camera.depth_camera import DepthCamera, default_pose
from binpick_env.camera.view import VISIBLE
from binpick_env.config import CameraConfig
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.scenes.clutter import visible_fractions
from perception.frame import Workspace
from perception.geometry import Floats, make_transform, quat_from_matrix, rotation_about
from perception.part import PartModel

_CAMERA = CameraConfig(width=640, height=480)
# d_max below which the camera magnifies [m], so that a small part is as long in the image as one of 0.06 m.
_LEAST = 0.06


def warm_up_capture(part: PartModel, workspace: Workspace) -> LabelledCapture:
    """Return the capture, by a small camera, of two parts that lie side by side on the floor of an empty bin.

    Args:
        part: Model of both parts; one lies as its frame is drawn, the other turned over by a third of a turn.
        workspace: Pose and inner box of the bin, whose walls are left out.

    Note:
        Takes 0.1 s. Random numbers come from a generator of its own; no physics is stepped.
    """
    T_world_parts = workspace.T_world_bin @ np.stack([_lying(part, 0.0, -0.3), _lying(part, 2 * np.pi / 3, 0.3)])
    model = _model(part, workspace, T_world_parts)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    instances = np.arange(model.ngeom) - 1  # the floor comes first
    camera = replace(_CAMERA, focal=_CAMERA.focal * max(1.0, _LEAST / part.d_max))
    above = default_pose(workspace, camera.distance)  # given: that this camera does not see the whole bin is no fault
    eye = DepthCamera(model, camera, workspace, instances, above, threads=1)
    capture = eye.capture(data, np.random.default_rng(0))
    return LabelledCapture(
        capture=capture,
        workspace=workspace,
        part=part,
        T_world_parts=T_world_parts,
        visible_fractions=visible_fractions(capture, part.mesh, T_world_parts),
    )


def _lying(part: PartModel, angle: float, aside: float) -> Floats:
    """Return a (4, 4) pose in the bin frame at which a part lies on the floor.

    Args:
        part: Model of the part.
        angle: Rotation about the x axis [rad].
        aside: Position of the centre along the x axis [d_max].
    """
    T_bin_part = make_transform(rotation_about((1, 0, 0), angle))
    lowest = (np.asarray(part.mesh.vertices) @ T_bin_part[:3, :3].T)[:, 2].min()
    centre = T_bin_part[:3, :3] @ part.centre
    T_bin_part[:3, 3] = aside * part.d_max - centre[0], -centre[1], -lowest
    return T_bin_part


def _model(part: PartModel, workspace: Workspace, T_world_parts: Floats) -> mujoco.MjModel:
    """Compile a model whose geoms are the bin's floor and the parts, in this order."""
    spec = mujoco.MjSpec()
    mesh = spec.add_mesh(name="part")
    mesh.uservert, mesh.userface = np.asarray(part.mesh.vertices).ravel(), np.asarray(part.mesh.faces).ravel()
    half = [*(workspace.inner_size[:2] / 2), 0.005]
    T_world_floor = workspace.T_world_bin @ make_transform(translation=(0.0, 0.0, -half[2]))
    kinds = [{"type": mujoco.mjtGeom.mjGEOM_BOX, "size": half}]
    kinds += [{"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": "part"}] * len(T_world_parts)
    for kind, T_world_geom in zip(kinds, [T_world_floor, *T_world_parts], strict=True):
        quat = quat_from_matrix(T_world_geom[:3, :3])
        spec.worldbody.add_geom(pos=T_world_geom[:3, 3], quat=quat, group=VISIBLE, **kind)
    return spec.compile()
