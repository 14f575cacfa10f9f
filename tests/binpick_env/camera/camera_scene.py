"""Small scenes with the conventions of the cell: visible geoms in group 2, collision in group 3, bodies ``part_i``."""

from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh

from binpick_env.config import BinConfig, CameraConfig
from perception.frame import Workspace
from perception.geometry import Floats, make_transform, quat_from_matrix, random_rotation

BOX, MESH, SPHERE = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_SPHERE
CAMERA = CameraConfig(width=480, height=360, backend="rays")


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    model: mujoco.MjModel
    data: mujoco.MjData
    workspace: Workspace
    instance_of_geom: np.ndarray
    T_world_parts: Floats


def tee() -> trimesh.Trimesh:
    """Return a T of two boxes: 60 x 20 x 20 mm with a 20 x 30 x 16 mm stem, off its own centre."""
    bar = trimesh.creation.box((0.06, 0.02, 0.02))
    stem = trimesh.creation.box((0.02, 0.03, 0.016))
    stem.apply_translation((0.004, 0.02, 0.001))
    return trimesh.boolean.union([bar, stem])


def random_poses(count: int, workspace: Workspace, seed: int) -> Floats:
    """Return (N, 4, 4) world poses strewn in the bin."""
    rng = np.random.default_rng(seed)
    half = workspace.inner_size / 2 - 0.04
    places = [rng.uniform([-half[0], -half[1], 0.03], [half[0], half[1], 0.1]) for _ in range(count)]
    return np.stack([workspace.T_world_bin @ make_transform(random_rotation(rng), p) for p in places])


def build(
    T_world_parts: Floats, mesh: trimesh.Trimesh | None = None, extra: list[dict[str, object]] | None = None
) -> Scene:
    """Build table, bin, one free body per pose and ``extra`` world geoms."""
    bin_ = BinConfig()
    workspace = bin_.workspace()
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    mesh = mesh or tee()
    spec.add_mesh(name="part", uservert=mesh.vertices.ravel(), userface=mesh.faces.ravel().astype(np.int32))
    spec.worldbody.add_geom(name="table", type=BOX, size=[0.8, 0.8, 0.05], pos=[0.3, 0, -0.05], group=2)
    _add_bin(spec, bin_, workspace)
    for i, T_world_part in enumerate(T_world_parts):
        quat = quat_from_matrix(T_world_part[:3, :3])
        body = spec.worldbody.add_body(name=f"part_{i}", pos=T_world_part[:3, 3], quat=quat)
        body.add_freejoint()
        body.add_geom(name=f"part_{i}/visual", type=MESH, meshname="part", group=2, contype=0, conaffinity=0)
        body.add_geom(type=SPHERE, size=[0.05, 0, 0], group=3)  # must never be seen
    for geom in extra or []:
        spec.worldbody.add_geom(**{"group": 2, **geom})
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    instances = np.full(model.ngeom, -1, np.int64)
    for i in range(len(T_world_parts)):
        instances[model.geom(f"part_{i}/visual").id] = i
    return Scene(
        model=model, data=data, workspace=workspace, instance_of_geom=instances, T_world_parts=np.asarray(T_world_parts)
    )


def _add_bin(spec: mujoco.MjSpec, bin_: BinConfig, workspace: Workspace) -> None:
    quat = quat_from_matrix(workspace.T_world_bin[:3, :3])
    body = spec.worldbody.add_body(name="bin", pos=workspace.T_world_bin[:3, 3], quat=quat)
    (x, y, z), t = np.array(bin_.inner_size) / 2, bin_.wall / 2
    body.add_geom(name="floor", type=BOX, size=[x + 2 * t, y + 2 * t, t], pos=[0, 0, -t], group=2)
    for sign in (-1, 1):
        body.add_geom(type=BOX, size=[t, y + 2 * t, z], pos=[sign * (x + t), 0, z], group=2)
        body.add_geom(type=BOX, size=[x, t, z], pos=[0, sign * (y + t), z], group=2)
