"""The cell without its parts, as the planner sees it: postures in, contacts and tcp poses out.

There are two models of one cell. ``model`` (14 joints: six of the arm, eight of the jaw's linkage) detects collisions
at any opening of the jaw. ``arm_model`` (six joints, the jaw rigid and open by its whole stroke) serves inverse
kinematics.
"""

from copy import copy
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from binpick_env.cell.robot import ARM_JOINTS, FINGER_PADS, GRIPPER, TCP_SITE
from binpick_env.cell.scene import cell_spec, surroundings_spec
from binpick_env.config import CellConfig
from perception.geometry import Floats, require_shape
from policies.motion._kernels import box_heights
from policies.motion.surroundings import with_surroundings

DOF = len(ARM_JOINTS)
MAX_CLEARANCE = 0.03  # contacts with the cell are found up to this distance [m]
_STATIC, _SHOULDER, _ARM, _JAW = 1, 2, 4, 8  # collision bits: the shoulder meets links only, the jaw never itself
_DRIVER_RANGE = (0.0, 0.8)  # positions of the 2F-85's driver joints, open and closed [rad]
_BASE_LINK = (0.076, 0.05)  # radius and half height of the arm's base, which Menagerie gives no collision shape [m]


@dataclass(frozen=True, kw_only=True)
class Contact:
    """Two bodies that touch, or come nearer than the clearance.

    Attributes:
        first: Name of one geom, or of its body where the geom has none.
        second: Name of the other geom or body.
        distance: Signed distance [m]; negative is penetration.
        gripper_on_cell: Whether the gripper meets the cell, so that the tcp's pose alone decides it.
    """

    first: str
    second: str
    distance: float
    gripper_on_cell: bool


class PlanningScene:
    """Kinematics and collision queries of the cell. Owns its simulation data; no query depends on an earlier one."""

    def __init__(self, config: CellConfig | None = None) -> None:
        """Compile the models; takes about a second.

        Args:
            config: The cell; the default cell if None.
        """
        self.config = config if config is not None else CellConfig()
        self.model = _planning_spec(self.config).compile()
        self.arm_model = _without_jaw_joints(_planning_spec(self.config)).compile()
        self._prepare()

    def around(self, config: CellConfig) -> "PlanningScene":
        """Return the scene of a cell with the same robot; only what stands around it is compiled, which takes 10 ms.

        Args:
            config: The cell. Pedestal, bin and tray may differ from this scene's, the robot may not.

        Raises:
            ValueError: The robot differs in more than its pedestal.
        """
        robot = replace(config.robot, pedestal_height=self.config.robot.pedestal_height)
        if robot != self.config.robot:
            raise ValueError(
                f"the robot must be the scene's {self.config.robot} but for its pedestal, got {config.robot}: make "
                "a PlanningScene of the other robot"
            )
        scene = copy(self)
        scene.config = config
        surroundings = _surroundings_spec(config).compile()
        scene.model, scene.arm_model = (
            with_surroundings(model, surroundings, config.robot.pedestal_height)
            for model in (self.model, self.arm_model)
        )
        scene._prepare()
        return scene

    def _prepare(self) -> None:
        """Calibrate the jaw, and note where the boxes of the cell stand."""
        self._data = mujoco.MjData(self.model)
        self._tcp = self.model.site(TCP_SITE).id
        self._drivers, self._openings = self._calibrate_jaw()
        jaw = self.config.robot.jaw
        self._max_opening = float(self._openings[0]) if jaw is None else min(jaw, float(self._openings[0]))
        self._open_jaw = _linkage(0.0) if jaw is None else self.jaw_posture(jaw)
        mujoco.mj_kinematics(self.model, self._data)
        boxes = (self.model.geom_type == mujoco.mjtGeom.mjGEOM_BOX) & (self.model.geom_contype == _STATIC)
        # All boxes are upright and never move.
        self._boxes = self._data.geom_xpos[boxes], self._data.geom_xmat[boxes], self.model.geom_size[boxes]

    @property
    def limits(self) -> Floats:
        """(6, 2) lower and upper joint limits [rad]."""
        return np.array([self.model.joint(name).range for name in ARM_JOINTS])

    @property
    def rim(self) -> float:
        """Height of the bin's rim above the table [m]."""
        return self.config.bin.wall + self.config.bin.inner_size[2]

    @property
    def max_opening(self) -> float:
        """Distance between the pads when the jaw is fully open [m]."""
        return self._max_opening

    def jaw_posture(self, opening: float) -> Floats:
        """Return the (8,) joint positions of the jaw's linkage [rad] for a distance between the pads [m], clipped."""
        driver = np.interp(-min(opening, self._max_opening), -self._openings, self._drivers)
        return _linkage(float(driver))

    def tcp_poses(self, q: Floats) -> Floats:
        """Return the (S, 4, 4) poses ``T_world_tcp`` of (S, 6) postures; the array is the caller's own."""
        poses = np.zeros((len(q), 4, 4))
        poses[:, 3, 3] = 1.0
        for pose, posture in zip(poses, q, strict=True):
            self._place(posture, None)
            pose[:3, :3] = self._data.site_xmat[self._tcp].reshape(3, 3)
            pose[:3, 3] = self._data.site_xpos[self._tcp]
        return poses

    def contacts(self, q: Floats, *, opening: float | None = None, clearance: float = 0.0) -> list[Contact]:
        """Return the robot's contacts with the cell and with itself, deepest first; empty means free.

        Args:
            q: (6,) posture [rad].
            opening: Distance between the pads [m]; None for the open jaw.
            clearance: Distance from the cell under which there is contact [m], at most ``MAX_CLEARANCE``. A negative
                one allows penetration up to that depth, since simulated contacts are soft.
        """
        if not -MAX_CLEARANCE <= clearance <= MAX_CLEARANCE:
            raise ValueError(f"clearance must be in [-{MAX_CLEARANCE}, {MAX_CLEARANCE}] m, got {clearance}")
        self._place(q, opening)
        mujoco.mj_collision(self.model, self._data)
        if self._data.ncon == 0:
            return []
        near = []
        for (a, b), distance in zip(self._data.contact.geom, self._data.contact.dist, strict=True):
            bits = self.model.geom_contype[a] | self.model.geom_contype[b]
            if distance < (clearance if bits & _STATIC else 0.0):
                names = self._geom_name(a), self._geom_name(b)
                contact = Contact(
                    first=names[0],
                    second=names[1],
                    distance=float(distance),
                    gripper_on_cell=bool(bits == _STATIC | _JAW),
                )
                near.append(contact)
        return sorted(near, key=lambda contact: contact.distance)

    def static_height(self, points_world: Floats) -> Floats:
        """Return the (P,) height [m] of the highest surface of table, bin and tray at the (P, 3) points' x and y."""
        require_shape("points_world", points_world, (None, 3))
        height: Floats = box_heights(np.ascontiguousarray(points_world), *self._boxes)
        return height

    def _place(self, q: Floats, opening: float | None) -> None:
        qpos = self._data.qpos  # the arm's joints come first
        qpos[:DOF] = q
        qpos[DOF:] = self._open_jaw if opening is None else self.jaw_posture(opening)
        mujoco.mj_kinematics(self.model, self._data)

    def _calibrate_jaw(self) -> tuple[Floats, Floats]:
        """Tabulate the distance between the pads over the driver's angle."""
        drivers = np.linspace(*_DRIVER_RANGE, 33)
        left, right = (self.model.geom(pads[0]).id for pads in FINGER_PADS)
        openings = []
        for driver in drivers:
            self._data.qpos[DOF:] = _linkage(driver)
            mujoco.mj_kinematics(self.model, self._data)
            openings.append(mujoco.mj_geomDistance(self.model, self._data, left, right, 0.2, None))
        return drivers, np.array(openings)

    def _geom_name(self, geom: int) -> str:
        return str(self.model.geom(geom).name or self.model.body(self.model.geom_bodyid[geom]).name)


def _linkage(driver: float) -> Floats:
    """Return the (8,) joint positions of both fingers; the pads stay parallel, as the four-bar linkage keeps them."""
    return np.array([driver, 0.0, driver, -driver, driver, 0.0, driver, -driver])


def _planning_spec(config: CellConfig) -> mujoco.MjSpec:
    """Return the cell stripped to its collision shapes, with the bits that decide which pairs may collide."""
    spec = cell_spec(config)
    radius, half = _BASE_LINK
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    spec.body("base").add_geom(name="arm_base", type=cylinder, size=[radius, half, 0], pos=[0, 0, half])
    spec.add_exclude(bodyname1="base", bodyname2="upper_arm_link")  # 3 mm apart in every posture
    robot = [body for body in spec.bodies if body.name in _arm_links(spec) or body.name.startswith(GRIPPER)]
    robot_names = {body.name for body in robot}
    for body in spec.bodies:
        for geom in list(body.geoms):
            if body.name in robot_names and geom.contype == 0:
                spec.delete(geom)  # the visible shapes
            elif body.name in robot_names:
                bit = _JAW if body.name.startswith(GRIPPER) else _ARM
                bit = _SHOULDER if body.name == "shoulder_link" else bit
                meets = {_JAW: _STATIC, _SHOULDER: _ARM | _JAW, _ARM: _STATIC | _ARM | _JAW}[bit]
                geom.contype, geom.conaffinity = bit, meets
                if geom.type == mujoco.mjtGeom.mjGEOM_BOX:
                    _as_mesh(spec, geom)
            elif geom.name:  # the base's visible shapes have no names
                _make_static(geom)
    used = {geom.meshname for body in spec.bodies for geom in body.geoms}
    for mesh in [mesh for mesh in spec.meshes if mesh.name not in used]:
        spec.delete(mesh)  # the visible shapes' meshes would take 30 MB of each model
    return spec


def _surroundings_spec(config: CellConfig) -> mujoco.MjSpec:
    """Return what stands around the robot, with the bits of the planner."""
    spec = surroundings_spec(config)
    for body in spec.bodies:
        for geom in body.geoms:
            _make_static(geom)
    return spec


def _make_static(geom: mujoco.MjsGeom) -> None:
    geom.contype, geom.conaffinity, geom.margin = _STATIC, 0, MAX_CLEARANCE


def _as_mesh(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> None:
    """Turn a box into a mesh of its corners: MuJoCo's box-box test misses some pairs that are near but apart."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    spec.add_mesh(name=geom.name, uservert=(signs * geom.size).ravel())
    geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, geom.name


def _arm_links(spec: mujoco.MjSpec) -> set[str]:
    return {spec.joint(name).parent.name for name in ARM_JOINTS}


def _without_jaw_joints(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Freeze the jaw at the model's zero, fully open."""
    for element in [*spec.equalities, *spec.actuators, *spec.tendons]:
        spec.delete(element)
    for joint in list(spec.joints):
        if joint.name not in ARM_JOINTS:
            spec.delete(joint)
    return spec
