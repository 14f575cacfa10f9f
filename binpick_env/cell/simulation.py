"""The physics of the cell: model and state, motion of the arm, parts in play, contacts."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from binpick_env.cell.jaw import open_command
from binpick_env.cell.protective_stop import ProtectiveStop
from binpick_env.cell.robot import ARM_JOINTS, FINGER_PADS, GRIPPER, GRIPPER_ACTUATOR, HOME, TCP_SITE
from binpick_env.cell.robot_contact import RobotContact
from binpick_env.cell.scene import BIN_BODY, PART, TABLE_GEOM, TRAY_BODY, cell_spec, parking_poses
from binpick_env.cell.simulation_state import Origin, SimulationSnapshot
from binpick_env.config import CONTROL_PERIOD, CellConfig
from binpick_env.parts.part import Part
from perception.geometry import Floats, make_transform, matrix_from_quat, quat_from_matrix

ARENA = 512 << 20  # memory of a state for contacts and constraints [bytes]
_JAW_REST = 1.0  # time after which the jaw's linkage is at rest under a new command [s]


class Simulation:
    """One cell with a number of copies of a part; those out of play are parked, weightless and asleep.

    Attributes:
        config: Settings of the cell.
        part: Part that is picked.
        capacity: Number of copies of the part.
        model: Compiled model.
        data: State of the model.
        part_of_geom: (ngeom,) part that each geom belongs to, -1 for none.
        is_robot_geom: (ngeom,) mask of the geoms of arm and gripper.
        in_play: (capacity,) mask of the parts in play.
        target: (6,) last joint targets [rad].
        gripper_target: Last gripper command, 0 open to 1 closed.
        gripper_open: Smallest gripper command that is obeyed: 0, or that of ``config.robot.jaw`` where one is set.
        substeps: Number of physics steps in a control period.
    """

    def __init__(self, config: CellConfig, part: Part, capacity: int) -> None:
        """Compile the cell with ``capacity`` copies of a part, and put it into its start."""
        self.config = config
        self.part = part
        self.capacity = capacity
        spec = cell_spec(config, part, capacity)
        spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
        # MuJoCo would silently reset a diverged state to the model's own start; it has to stay visible instead.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        # Noslip's matrix over a dense heap of 400 contacts exceeds MuJoCo's 18 MB, and 28 falling gears of 8 pieces
        # exceeded 128 MB: contacts are then left out, which is fatal beside sleeping parts. Unused memory is never
        # paged in.
        spec.memory = ARENA
        spec.option.sleep_tolerance = config.contact.sleep_tolerance
        self.model: mujoco.MjModel = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._index()
        self._parking = parking_poses(capacity)
        # Noslip keeps a gripped part from creeping. While nothing is gripped it would cost two thirds of the time.
        self._noslip = int(self.model.opt.noslip_iterations)
        self.substeps = round(CONTROL_PERIOD / self.model.opt.timestep)
        # A uniform quadratic B-spline through the targets: smooth in velocity, half a control period late.
        self._spline_times = np.array([k / self.substeps for k in range(1, self.substeps + 1)])
        blends = [0.5 * np.array([(1 - s) ** 2, 1 + 2 * s - 2 * s**2, s**2]) for s in self._spline_times.tolist()]
        self._spline_blends = np.stack(blends)
        self.gripper_open = 0.0
        self.reset()
        if config.robot.jaw is not None:
            self._limit_jaw(config.robot.jaw)

    def _index(self) -> None:
        """Look up where joints, geoms and actuators stand in the model's arrays."""
        model = self.model
        self._part_body = np.array([model.body(f"{PART}{i}").id for i in range(self.capacity)])
        joints = [model.joint(f"{PART}{i}") for i in range(self.capacity)]
        self._part_qpos = np.array([j.qposadr[0] for j in joints])[:, None] + np.arange(7)
        self._part_dof = np.array([j.dofadr[0] for j in joints])[:, None] + np.arange(6)
        self._part_tree = model.body_treeid[self._part_body]
        part_of_body = np.full(model.nbody, -1)
        part_of_body[self._part_body] = np.arange(self.capacity)
        self.part_of_geom: NDArray[np.int64] = part_of_body[model.geom_bodyid]
        robot = model.body_rootid == model.body("base").id
        self.is_robot_geom: NDArray[np.bool_] = robot[model.geom_bodyid]
        cell = {model.body(BIN_BODY).id, model.body(TRAY_BODY).id}
        self._is_cell_geom = np.isin(model.geom_bodyid, list(cell))
        self._is_cell_geom[model.geom(TABLE_GEOM).id] = True
        self._pads = [[model.geom(name).id for name in side] for side in FINGER_PADS]
        self._arm_qpos = np.array([model.joint(name).qposadr[0] for name in ARM_JOINTS])
        self._arm_dof = np.array([model.joint(name).dofadr[0] for name in ARM_JOINTS])
        self._gripper_actuator = model.actuator(GRIPPER_ACTUATOR).id
        jaw = [j for j in range(model.njnt) if model.joint(j).name.startswith(GRIPPER)]
        self._jaw_qpos, self._jaw_dof = model.jnt_qposadr[jaw], model.jnt_dofadr[jaw]
        self._driver_qpos = model.joint(GRIPPER + "right_driver_joint").qposadr[0]
        self._driver_range = model.joint(GRIPPER + "right_driver_joint").range[1]
        self._tcp = model.site(TCP_SITE).id
        # The servo's torque is kp (ctrl - q) - kv qd. Feeding the target's velocity forward cancels its lag of kv / kp
        # (0.2 s), feeding the links' inertia forward what is left (15 mrad at 10 rad/s^2), as a real controller does.
        self._stiffness = model.actuator_gainprm[:6, 0]
        self._lag = -model.actuator_biasprm[:6, 2] / self._stiffness
        self._stop = ProtectiveStop(model, self.data, self._arm_dof[0], self._tcp, self.config.robot.protective_stop)
        self._origin = Origin.of(model, self.config, self.part.model.name, self.capacity)

    # --- state -----------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Put the arm to its home position with the gripper open, and park every part."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self._arm_qpos] = HOME
        self.data.ctrl[:6] = HOME
        self.in_play: NDArray[np.bool_] = np.zeros(self.capacity, dtype=bool)
        self.target = HOME.copy()
        self._target_before = HOME.copy()
        self._stop.active = None
        self.gripper_target = self.gripper_open
        if self.gripper_open > 0:
            self.put_jaw(self._open_posture, self.gripper_open)
        for i in range(self.capacity):
            self.park(i)
        mujoco.mj_forward(self.model, self.data)

    def snapshot(self) -> SimulationSnapshot:
        """Return the whole state for :meth:`restore`; takes 1 ms and half a megabyte."""
        data = mujoco.MjData(self.model)
        mujoco.mj_copyData(data, self.model, self.data)
        return SimulationSnapshot(
            origin=self._origin,
            data=data,
            in_play=self.in_play.copy(),
            target=self.target.copy(),
            target_before=self._target_before.copy(),
            gripper_target=self.gripper_target,
            stop=self._stop.active,
        )

    def restore(self, snapshot: SimulationSnapshot) -> None:
        """Go back to a state of this simulation, or of another one with the same part, capacity and settings.

        Raises:
            ValueError: The snapshot is of another cell.
        """
        self._origin.require(snapshot.origin)
        mujoco.mj_copyData(self.data, self.model, snapshot.data)
        self.in_play = snapshot.in_play.copy()
        self.model.body_gravcomp[self._part_body] = np.where(self.in_play, 0.0, 1.0)
        self.target, self._target_before = snapshot.target.copy(), snapshot.target_before.copy()
        self.gripper_target, self._stop.active = snapshot.gripper_target, snapshot.stop

    def refresh(self) -> None:
        """Bring the bodies' poses up to date with the joints; after a step they are one time step behind."""
        mujoco.mj_kinematics(self.model, self.data)

    def advance(self, duration: float) -> None:
        """Run the physics for ``duration`` [s] with unchanged targets, while nothing is gripped."""
        self.model.opt.noslip_iterations = 0
        mujoco.mj_step(self.model, self.data, round(duration / self.model.opt.timestep))

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return float(self.data.time)

    @property
    def stopped(self) -> bool:
        """Whether the protective stop holds the arm."""
        return self._stop.active is not None

    @property
    def joint_positions(self) -> Floats:
        """(6,) positions of the arm's joints [rad]."""
        return np.array(self.data.qpos[self._arm_qpos])

    @property
    def joint_velocities(self) -> Floats:
        """(6,) velocities of the arm's joints [rad/s]."""
        return np.array(self.data.qvel[self._arm_dof])

    @property
    def gripper_position(self) -> float:
        """Measured position of the jaw, 0 open to 1 closed."""
        return float(np.clip(self.data.qpos[self._driver_qpos] / self._driver_range, 0.0, 1.0))

    @property
    def T_world_tcp(self) -> Floats:
        """(4, 4) pose of the tool centre point."""
        return make_transform(self.data.site_xmat[self._tcp].reshape(3, 3), self.data.site_xpos[self._tcp])

    def part_poses(self) -> Floats:
        """Return the (capacity, 4, 4) world poses of the part frames."""
        qpos = self.data.qpos[self._part_qpos]
        poses = np.zeros((self.capacity, 4, 4))
        poses[:, :3, :3] = matrix_from_quat(qpos[:, 3:])
        poses[:, :3, 3] = qpos[:, :3]
        poses[:, 3, 3] = 1.0
        return poses

    def part_centres(self) -> Floats:
        """Return the (capacity, 3) world positions of the parts' centres."""
        poses = self.part_poses()
        return poses[:, :3, :3] @ self.part.model.centre + poses[:, :3, 3]

    def part_speeds(self) -> Floats:
        """Return the (capacity,) largest speeds of points within d_max / 2 of a part's centre [m/s]; 0 when asleep."""
        velocity = self.data.qvel[self._part_dof]
        spin = np.linalg.norm(velocity[:, 3:], axis=1) * self.part.model.d_max / 2
        speeds: Floats = np.linalg.norm(velocity[:, :3], axis=1) + spin
        return speeds

    def asleep(self) -> NDArray[np.bool_]:
        """Return the (capacity,) mask of sleeping parts."""
        return np.array(self.data.tree_asleep[self._part_tree] >= 0)

    # --- parts -----------------------------------------------------------------------------------------------------

    def place(self, i: int, T_world_part: Floats) -> None:
        """Put part ``i`` into play at a (4, 4) pose, at rest."""
        self.move(i, T_world_part)
        # A part that is awake but about to fall asleep would do so where it was put, in mid-air: begin its wait anew.
        trees = self.data.tree_asleep
        if trees[self._part_tree[i]] < 0:
            trees[self._part_tree[i]] = -(1 + mujoco.mjMINAWAKE)
        self.model.body_gravcomp[self._part_body[i]] = 0.0
        self.in_play[i] = True

    def park(self, i: int) -> None:
        """Take part ``i`` out of play, to its parking position."""
        self.move(i, self._parking[i])
        self.model.body_gravcomp[self._part_body[i]] = 1.0
        self.in_play[i] = False

    def move(self, i: int, T_world_part: Floats) -> None:
        """Put part ``i`` at a (4, 4) pose, at rest; whether it is in play does not change."""
        # A changed qpos wakes a sleeping tree, and every tree that sleeps in one island with it, at the next step. It
        # does nothing to a tree that is awake.
        self.data.qpos[self._part_qpos[i]] = [*T_world_part[:3, 3], *quat_from_matrix(T_world_part[:3, :3])]
        self.data.qvel[self._part_dof[i]] = 0.0
        self.data.qacc_warmstart[self._part_dof[i]] = 0.0

    # --- motion ----------------------------------------------------------------------------------------------------

    def step(self, joint_targets: Floats, gripper: float) -> None:
        """Advance by one control period.

        Args:
            joint_targets: (6,) arm joint positions to be reached at the period's end [rad]; the change from the last
                target is held to the arm's velocity. They are not obeyed while the protective stop holds the arm.
            gripper: 0 open to 1 closed; held to the jaw's speed, and to its largest opening.
        """
        reach = self.config.robot.max_velocity * CONTROL_PERIOD
        goal = self.target + np.clip(joint_targets - self.target, -reach, reach)
        if self._stop.begin(goal - self.target):
            goal = self.target
        velocity_before = (self.target - self._target_before) / CONTROL_PERIOD
        velocity_after = (goal - self.target) / CONTROL_PERIOD
        inertial = self._inertial_torque((velocity_after - velocity_before) / CONTROL_PERIOD) / self._stiffness
        jaw_from, jaw_to = self._jaw_ramp(gripper)
        self.model.opt.noslip_iterations = self._noslip if self.gripped() else 0
        let_go = self.touched_by_robot() if jaw_to < jaw_from else None
        targets = np.stack([self._target_before, self.target, goal])
        velocities = velocity_before + self._spline_times[:, None] * (velocity_after - velocity_before)
        controls = np.stack([blend @ targets for blend in self._spline_blends]) + self._lag * velocities + inertial
        held = None
        for s, control in zip(self._spline_times.tolist(), controls, strict=True):
            self.data.ctrl[:6] = control if held is None else held
            self.data.ctrl[self._gripper_actuator] = 255.0 * (jaw_from + s * (jaw_to - jaw_from))
            mujoco.mj_step(self.model, self.data)
            if held is None and self._stop.trips():
                held = self.joint_positions
        self._target_before, self.target = (self.target, goal) if held is None else (held, held)
        self.gripper_target = jaw_to
        if let_go is not None:
            self._wake(let_go)
        self._check_finite()

    # --- motion without physics ------------------------------------------------------------------------------------

    def refresh_contacts(self) -> None:
        """Bring poses and contacts up to date with the joints, without a step."""
        self.refresh()
        mujoco.mj_collision(self.model, self.data)

    def put_arm(self, target_before: Floats, target: Floats) -> None:
        """Put the arm where :meth:`step` would leave it, without letting time pass.

        Args:
            target_before: (6,) joint targets of the step before [rad].
            target: (6,) joint targets of the step [rad].
        """
        # The spline through the targets runs half a control period late.
        self.data.qpos[self._arm_qpos] = (target_before + target) / 2
        self.data.qvel[self._arm_dof] = (target - target_before) / CONTROL_PERIOD
        self.data.qacc_warmstart[self._arm_dof] = 0.0
        self._target_before, self.target = np.array(target_before), np.array(target)
        self._stop.active = None

    def put_jaw(self, posture: Floats, gripper: float) -> None:
        """Put the jaw's linkage at rest.

        Args:
            posture: (J,) positions of the linkage's joints [rad].
            gripper: Command that holds them there, 0 open to 1 closed.
        """
        self.data.qpos[self._jaw_qpos] = posture
        self.data.qvel[self._jaw_dof] = 0.0
        self.data.qacc_warmstart[self._jaw_dof] = 0.0
        self.data.ctrl[self._gripper_actuator] = 255.0 * gripper
        self.gripper_target = gripper

    def jaw_postures(self, commands: Floats, rest: float) -> Floats:
        """Return the (N, J) positions of the joints of the jaw's linkage under commands [rad], measured on a copy.

        Args:
            commands: (N,) gripper commands, 0 open to 1 closed, given one after the other.
            rest: Time that the jaw gets to come to rest under each [s].
        """
        data = self.snapshot().data
        postures = np.empty((len(commands), len(self._jaw_qpos)))
        for k, command in enumerate(commands):
            data.ctrl[self._gripper_actuator] = 255.0 * command
            mujoco.mj_step(self.model, data, round(rest / self.model.opt.timestep))
            postures[k] = data.qpos[self._jaw_qpos]
        return postures

    # --- inside ----------------------------------------------------------------------------------------------------

    def _limit_jaw(self, jaw: float) -> None:
        """Let the jaw open no wider than ``jaw`` [m] from now on, and put everything back to its start."""
        command = open_command(jaw)
        self._open_posture = self.jaw_postures(np.array([command]), _JAW_REST)[0]
        self.gripper_open = command
        self.reset()

    def _wake(self, parts: NDArray[np.bool_]) -> None:
        """Wake the sleeping ones among the parts of a (capacity,) mask.

        MuJoCo would otherwise let a part that hung still in the jaw sleep in mid-air when the pads leave it.
        """
        for i in np.flatnonzero(parts & self.asleep() & self.in_play):
            T_world_part = self.part_poses()[i]
            T_world_part[2, 3] -= 1e-6  # moving a part wakes it
            self.move(int(i), T_world_part)

    def _inertial_torque(self, acceleration: Floats) -> Floats:
        """Return the (6,) joint torques [N m] for (6,) joint accelerations [rad/s^2], gravity and velocity left out."""
        joint_acceleration = np.zeros(self.model.nv)
        joint_acceleration[self._arm_dof] = acceleration
        torque = np.zeros(self.model.nv)
        mujoco.mj_mulM(self.model, self.data, torque, joint_acceleration)
        return np.array(torque[self._arm_dof])

    def _jaw_ramp(self, gripper: float) -> tuple[float, float]:
        """Return the gripper command at a control period's start and end; opening starts from the jaw's position."""
        stroke = CONTROL_PERIOD / self.config.robot.gripper_time
        goal = float(np.clip(gripper, self.gripper_open, 1.0))
        start = min(self.gripper_target, self.gripper_position) if goal < self.gripper_target else self.gripper_target
        return start, start + float(np.clip(goal - start, -stroke, stroke))

    def _check_finite(self) -> None:
        if not (np.all(np.isfinite(self.data.qpos)) and np.all(np.isfinite(self.data.qvel))):
            raise FloatingPointError(f"the physics diverged at t = {self.time:.3f} s (NaN in the state)")

    # --- contacts --------------------------------------------------------------------------------------------------

    def robot_contact(self) -> RobotContact:
        """Return what the robot touches now, other than itself, and the force."""
        force, with_cell, parts = 0.0, False, set()
        wrench = np.zeros(6)
        for c in range(self.data.ncon):
            g1, g2 = self.data.contact.geom[c]
            if self.is_robot_geom[g1] == self.is_robot_geom[g2]:
                continue
            other = g2 if self.is_robot_geom[g1] else g1
            mujoco.mj_contactForce(self.model, self.data, c, wrench)
            force += float(np.linalg.norm(wrench[:3]))
            with_cell |= bool(self._is_cell_geom[other])
            if self.part_of_geom[other] >= 0:
                parts.add(int(self.part_of_geom[other]))
        return RobotContact(force=force, with_cell=with_cell, parts=frozenset(parts))

    def robot_ends(self) -> NDArray[np.bool_]:
        """Return the (C, 2) mask of the contacts' ends that are the robot's."""
        return np.array(self.is_robot_geom[self.data.contact.geom[: self.data.ncon]])

    def part_ends(self) -> NDArray[np.int64]:
        """Return the (C, 2) parts at the contacts' ends, -1 for anything else."""
        return np.array(self.part_of_geom[self.data.contact.geom[: self.data.ncon]])

    def touched_by_robot(self) -> NDArray[np.bool_]:
        """Return the (capacity,) mask of parts that touch any link of the robot."""
        touched = np.zeros(self.capacity, dtype=bool)
        partners = self.part_ends()[self.robot_ends()[:, ::-1]]
        touched[partners[partners >= 0]] = True
        return touched

    def gripped(self) -> frozenset[int]:
        """Return the parts that both finger pads touch."""
        touched: list[set[int]] = []
        pairs = self.data.contact.geom[: self.data.ncon]
        for pads in self._pads:
            partners = np.concatenate([pairs[np.isin(pairs[:, 0], pads), 1], pairs[np.isin(pairs[:, 1], pads), 0]])
            touched.append({int(p) for p in self.part_of_geom[partners] if p >= 0})
        return frozenset(touched[0] & touched[1])
