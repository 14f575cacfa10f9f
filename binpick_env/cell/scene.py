"""The cell as one MjSpec: robot, table, bin, drop tray and parts.

Visible geoms are in group 2, collision shapes in group 3; cameras see group 2 only.
"""

from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np
import trimesh

from binpick_env.cell.robot import add_pedestal, robot_spec
from binpick_env.config import CellConfig, ContactConfig
from binpick_env.parts.part import Part
from perception.geometry import Floats, make_transform, quat_from_matrix
from perception.thickness import part_thickness

VISIBLE, COLLISION = 2, 3
LEAST_DEPTH = 0.02  # least depth of a floor for contacts [m]; thin parts fall through shallower ones
THIN = 0.012  # thickness under which parts have stiff contacts, so that they do not pass through each other [m]
LIGHT = 0.05  # mass under which they have stiff contacts, so that the arm does not press them through a floor [kg]
PART = "part_"  # bodies are part_0, part_1, ...
BIN_BODY, TRAY_BODY, TABLE_GEOM = "bin", "tray", "table"

_BIN_COLOUR, _TRAY_COLOUR = (0.32, 0.36, 0.42, 1), (0.3, 0.42, 0.34, 1)
_BOX = mujoco.mjtGeom.mjGEOM_BOX
_MESH = mujoco.mjtGeom.mjGEOM_MESH


def cell_spec(config: CellConfig, part: Part | None = None, num_parts: int = 0) -> mujoco.MjSpec:
    """Build the cell, with copies of a part as free bodies that are parked in a grid below the table.

    Args:
        config: Settings of the cell.
        part: Part to be copied; None adds none.
        num_parts: Number of copies.
    """
    spec = robot_spec(config.robot)
    spec.option.timestep = config.timestep
    spec.visual.global_.offwidth = max(1280, config.camera.width)
    spec.visual.global_.offheight = max(960, config.camera.height)
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.worldbody.add_light(name="lamp", pos=[0.2, -0.4, 2.0], dir=[0.1, 0.2, -1.0], castshadow=True)
    _add_surroundings(spec, config)
    if part is not None and num_parts > 0:
        _add_parts(spec, part, num_parts, config.contact)
    return spec


def surroundings_spec(config: CellConfig) -> mujoco.MjSpec:
    """Build what stands around the robot of the cell: pedestal, table, bin and drop tray, without the robot itself."""
    spec = mujoco.MjSpec()
    add_pedestal(spec, config.robot.pedestal_height)
    _add_surroundings(spec, config)
    return spec


def _add_surroundings(spec: mujoco.MjSpec, config: CellConfig) -> None:
    """Add table, bin and drop tray."""
    spec.worldbody.add_geom(
        name=TABLE_GEOM, type=_BOX, size=[0.8, 0.8, 0.05], pos=[0.3, 0, -0.05], rgba=[0.55, 0.5, 0.45, 1], group=VISIBLE
    )
    T_world_tray = make_transform(translation=(*config.tray.position, config.tray.wall))
    boxes = (
        _OpenBox(BIN_BODY, config.bin.workspace().T_world_bin, config.bin.inner_size, config.bin.wall, _BIN_COLOUR),
        _OpenBox(TRAY_BODY, T_world_tray, config.tray.inner_size, config.tray.wall, _TRAY_COLOUR),
    )
    for box in boxes:
        _add_box(spec, box, config.contact)


class _OpenBox(NamedTuple):
    """A box without a lid; the origin of its frame is the centre of the inner floor."""

    name: str
    T_world_box: Floats
    inner_size: tuple[float, float, float]  # length, width, height inside [m]
    wall: float  # thickness of walls and floor [m]
    rgba: tuple[float, float, float, float]


def _add_box(spec: mujoco.MjSpec, box: _OpenBox, contact: ContactConfig) -> None:
    quat = quat_from_matrix(box.T_world_box[:3, :3])
    body = spec.worldbody.add_body(name=box.name, pos=box.T_world_box[:3, 3], quat=quat)
    length, width, height = box.inner_size
    long, short, high = length / 2, width / 2, height / 2
    wall, half = box.wall, box.wall / 2
    sides = {
        "floor": ([long + wall, short + wall, half], [0, 0, -half]),
        "wall_x+": ([half, short + wall, high], [long + half, 0, high]),
        "wall_x-": ([half, short + wall, high], [-long - half, 0, high]),
        "wall_y+": ([long, half, high], [0, short + half, high]),
        "wall_y-": ([long, half, high], [0, -short - half, high]),
    }
    for side, (size, pos) in sides.items():
        geom = body.add_geom(name=f"{box.name}/{side}", type=_BOX, size=size, pos=pos, rgba=box.rgba, group=VISIBLE)
        if side == "floor" and wall < LEAST_DEPTH:
            geom.contype = geom.conaffinity = 0
            size, pos = [size[0], size[1], LEAST_DEPTH / 2], [0, 0, -LEAST_DEPTH / 2]
            geom = body.add_geom(name=f"{box.name}/floor_contact", type=_BOX, size=size, pos=pos, group=COLLISION)
        _apply(geom, contact)


def _add_parts(spec: mujoco.MjSpec, part: Part, num_parts: int, contact: ContactConfig) -> None:
    contact = contact_of(part, contact, spec.option.timestep)
    _add_mesh(spec, "part", part.model.mesh)
    for k, piece in enumerate(part.pieces):
        _add_mesh(spec, f"part/piece_{k}", piece)
    for i, T_world_part in enumerate(parking_poses(num_parts)):
        body = spec.worldbody.add_body(name=f"{PART}{i}", pos=T_world_part[:3, 3])
        body.add_freejoint(name=f"{PART}{i}")
        body.joints[0].damping = [contact.joint_damping, 0, 0]  # linear, and no higher orders of velocity
        body.explicitinertial = True
        body.mass = part.mass
        body.ipos = part.model.centre
        body.fullinertia = [*np.diag(part.inertia), part.inertia[0, 1], part.inertia[0, 2], part.inertia[1, 2]]
        body.add_geom(
            name=f"{PART}{i}/visual",
            type=_MESH,
            meshname="part",
            rgba=[0.62, 0.64, 0.67, 1],
            group=VISIBLE,
            contype=0,
            conaffinity=0,
            mass=0,
        )
        for k in range(len(part.pieces)):
            geom = body.add_geom(
                name=f"{PART}{i}/piece_{k}", type=_MESH, meshname=f"part/piece_{k}", group=COLLISION, mass=0
            )
            _apply(geom, contact)


def contact_of(part: Part, contact: ContactConfig, timestep: float) -> ContactConfig:
    """Return the contacts of a part. Thin parts and light ones have the stiffest that a time step allows.

    A part that lands sinks in by about 0.35 of its speed times the contacts' time constant: 7 mm at 2 m/s and 10 ms.
    Plates of 5 mm would pass through each other and stay crossed, so that one is picked with the other. Under a force,
    contacts yield in inverse proportion to the part's mass: an arm at full speed would press a part of 16 g half
    through a floor of 20 mm.

    Args:
        part: Kind of part.
        contact: Contacts of everything else.
        timestep: Time step of the physics [s], of which MuJoCo needs two to resolve a contact.
    """
    constant, damping = contact.solref
    sturdy = part_thickness(part.model) >= THIN and part.mass >= LIGHT
    if sturdy or not 0 < 2 * timestep < constant:
        return contact
    return replace(contact, solref=(2 * timestep, damping))


def _add_mesh(spec: mujoco.MjSpec, name: str, mesh: trimesh.Trimesh) -> None:
    spec.add_mesh(
        name=name,
        uservert=np.asarray(mesh.vertices, dtype=np.float64).ravel(),
        userface=np.asarray(mesh.faces, dtype=np.int32).ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,  # mass is explicit; a shell accepts any piece
    )


def _apply(geom: mujoco.MjsGeom, contact: ContactConfig) -> None:
    geom.condim = contact.condim
    geom.friction = contact.friction
    geom.solref = contact.solref
    geom.solimp = contact.solimp


def parking_poses(num_parts: int) -> Floats:
    """Return (N, 4, 4) world poses in a grid far below the table, where parts out of play are kept."""
    i = np.arange(num_parts)
    poses = np.tile(np.eye(4), (num_parts, 1, 1))
    poses[:, 0, 3] = -3.0 - 0.25 * (i % 6)
    poses[:, 1, 3] = 0.25 * (i // 6)
    poses[:, 2, 3] = -4.0
    return poses
