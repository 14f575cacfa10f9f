"""The motion of a recording: poses of robot and parts, collected step by step, written per entity at the end."""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from binpick_env.camera.view import visible_geoms
from binpick_env.cell.simulation import Simulation
from perception.geometry import Floats, quat_from_matrix

STILL = 1e-5  # change of a position [m] or quaternion up to which a pose is not written again


class Motion:
    """Collects poses of the robot's links and of the parts in play, the jaw's opening and the force on the robot."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        model = simulation.model
        geoms = visible_geoms(model)
        moving = (model.body_weldid[model.geom_bodyid[geoms]] != 0) & (simulation.part_of_geom[geoms] < 0)
        self._bodies: NDArray[np.int64] = np.unique(model.geom_bodyid[geoms][moving]).astype(np.int64)
        names = [model.body(int(body)).name.replace("/", "_") for body in self._bodies]
        self.paths = {int(body): f"world/robot/{name}" for body, name in zip(self._bodies, names, strict=True)}
        self._times: list[float] = []
        self._links: list[Floats] = []  # (B, 7) each: position [m], wxyz
        self._scalars: list[tuple[float, float, float]] = []
        self._part_times: list[float] = []
        self._parts: list[Floats] = []  # (N, 7) each, of the parts in play

    def add(self) -> None:
        """Collect the present state; the simulation is not changed."""
        simulation = self._simulation
        self._times.append(simulation.time)
        self._links.append(self._links_now())
        push = simulation.robot_contact()
        self._scalars.append((simulation.gripper_position, simulation.gripper_target, push.force))
        parts = self._parts_now()
        last = self._parts[-1] if self._parts else None
        if last is None or last.shape != parts.shape or np.any(np.abs(parts - last) > STILL):
            self._part_times.append(simulation.time)
            self._parts.append(parts)

    def log_now(self, stream: rr.RecordingStream) -> None:
        """Write the present poses of robot and parts at the stream's present time."""
        for path, link in zip(self.paths.values(), self._links_now(), strict=True):
            stream.log(path, rr.Transform3D(translation=link[:3], quaternion=np.roll(link[3:], -1)))
        positions, quaternions, scales = instance_poses(self._parts_now())
        poses = rr.InstancePoses3D(translations=positions, quaternions=quaternions, scales=scales)
        stream.log("world/parts", poses)

    def send(self, stream: rr.RecordingStream) -> None:
        """Write all that was collected, on the timeline ``time``."""
        if not self._times:
            return
        times = rr.TimeColumn("time", duration=np.array(self._times))
        links = np.stack(self._links)
        for k, path in enumerate(self.paths.values()):
            quaternions = np.roll(links[:, k, 3:], -1, axis=1)
            stream.send_columns(
                path, [times], rr.Transform3D.columns(translation=links[:, k, :3], quaternion=quaternions)
            )
        for path, values in zip(("gripper/closed", "gripper/target", "force"), np.array(self._scalars).T, strict=True):
            stream.send_columns(path, [times], rr.Scalars.columns(scalars=values))
        moments = [instance_poses(parts) for parts in self._parts]
        positions, quaternions, scales = (np.concatenate(each) for each in zip(*moments, strict=True))
        poses = rr.InstancePoses3D.columns(translations=positions, quaternions=quaternions, scales=scales)
        moved = rr.TimeColumn("time", duration=np.array(self._part_times))
        stream.send_columns("world/parts", [moved], poses.partition([len(each[0]) for each in moments]))

    def _links_now(self) -> Floats:
        data = self._simulation.data
        return np.hstack([data.xpos[self._bodies], data.xquat[self._bodies]])

    def _parts_now(self) -> Floats:
        return pack(self._simulation.part_poses()[self._simulation.in_play])


def pack(T_world: Floats) -> Floats:
    """Return (N, 4, 4) poses as (N, 7): position [m] and quaternion wxyz."""
    return np.hstack([T_world[:, :3, 3], quat_from_matrix(T_world[:, :3, :3])])


def instance_poses(poses: Floats) -> tuple[Floats, Floats, Floats]:
    """Return translations (N, 3), quaternions (N, 4) xyzw and scales (N, 3) at which a viewer draws a mesh.

    A viewer without any pose would draw the mesh once, at the origin. (0, 7) poses therefore give one of scale 0.

    Args:
        poses: (N, 7) positions [m] and quaternions wxyz, as `pack` returns them.
    """
    if len(poses) == 0:
        return np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]), np.zeros((1, 3))
    return poses[:, :3], np.roll(poses[:, 3:], -1, axis=1), np.ones((len(poses), 3))
