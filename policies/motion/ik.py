"""Inverse kinematics of the arm: one pose, or a straight line of poses, to joint positions.

mink's differential IK in a loop, on a model whose jaw is rigid (six joints, 0.1 ms an iteration). A pose fixes the
gripper, so the collision avoidance limit can only choose between the arm's postures, and it makes an iteration several
times as dear. Hence it comes last: solve freely, ask the scene for contacts, and only then solve with the limit on.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import mink
import mujoco
import numpy as np

from binpick_env.cell.robot import ARM_JOINTS, HOME, TCP_SITE
from perception.geometry import Floats, make_transform, require_shape, rotation_about, rotation_angle
from policies.motion.planning_scene import DOF, Contact, PlanningScene
from policies.motion.targets import checked_pose, checked_postures, interpolate_poses, pose_residual, turn_about_base

_WRAPS = 2 * np.pi * np.array([-1.0, 0.0, 1.0])
_JAW_FLIP = make_transform(np.diag([-1.0, -1.0, 1.0]))  # half a turn about the approach: the same grasp
_PAN, _ELBOW, _WRIST_1, _WRIST_2, _WRIST_3 = 0, 2, 3, 4, 5


@dataclass(frozen=True, kw_only=True)
class IkSettings:
    """When a solution is good enough and how hard to look for it."""

    position_tolerance: float = 3e-4  # [m]
    rotation_tolerance: float = 3e-3  # [rad]
    max_iterations: int = 40  # of one descent
    max_step: float = 0.5  # of any joint in one iteration [rad]
    restarts: int = 8  # descents beyond the first
    near: float = 2.2  # a free solution that moves no joint but the last further than this ends the search [rad]
    rotation_cost: float = 0.3  # of a radian against a metre
    posture_cost: float = 1e-4  # pulls towards the seed; biases a solution by less than 1e-6
    max_jump: float = 0.35  # of any joint between two samples of a line [rad]
    line_spacing: float = 0.005  # between the samples of a line [m]
    guard_distance: float = 0.003  # that the collision avoidance limit keeps [m]
    guarded_step: float = 0.05  # like `max_step` where that limit is on, which holds to first order only [rad]

    def __post_init__(self) -> None:
        for name in (
            "position_tolerance",
            "rotation_tolerance",
            "max_iterations",
            "max_step",
            "max_jump",
            "line_spacing",
        ):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if self.restarts < 0:
            raise ValueError(f"restarts must be at least 0, got {self.restarts}")


@dataclass(frozen=True, eq=False, kw_only=True)
class IkResult:
    """The best posture found for a pose.

    Attributes:
        q: (6,) joint positions [rad].
        converged: Whether the pose is reached within the tolerances.
        position_error: Distance of the tcp from the target [m].
        rotation_error: Angle between tcp and target [rad].
        iterations: Of all descents together.
        contacts: Where the posture touches the cell or the arm itself, deepest first.
        margin: Smallest singular value of the tcp's Jacobian (metres and radians as they come); 0 at a singularity.
    """

    q: Floats
    converged: bool
    position_error: float
    rotation_error: float
    iterations: int
    contacts: tuple[Contact, ...]
    margin: float

    @property
    def collision(self) -> bool:
        """Whether the posture touches anything."""
        return bool(self.contacts)

    @property
    def hopeless(self) -> bool:
        """Whether the pose itself puts the gripper into the cell, so that no other posture would help."""
        return self.converged and any(contact.gripper_on_cell for contact in self.contacts)

    @property
    def ok(self) -> bool:
        """Whether the pose is reached without contact."""
        return self.converged and not self.collision


@dataclass(frozen=True, eq=False, kw_only=True)
class CartesianPath:
    """Postures along a straight line of the tcp.

    Attributes:
        q: (S, 6) joint positions, the first where the line starts [rad]; up to the failure if there was one.
        complete: Whether the line's end was reached.
        jumped: Whether it ended because a joint would have jumped, otherwise because a pose is out of reach.
    """

    q: Floats
    complete: bool
    jumped: bool = False


class IkSolver:
    """Solves for the tcp's pose. Deterministic: the same call gives the same bits."""

    def __init__(self, scene: PlanningScene, settings: IkSettings | None = None, *, home: Floats = HOME) -> None:
        """Prepare the tasks.

        Args:
            scene: Answers for kinematics and collisions.
            settings: Tolerances and effort; the defaults if None.
            home: (6,) posture that restarts are made from, elbow up [rad].
        """
        require_shape("home", np.asarray(home), (DOF,))
        self.settings = settings if settings is not None else IkSettings()
        self._scene = scene
        self._home = np.asarray(home, dtype=np.float64)
        self._limits = scene.limits
        model = scene.arm_model
        self._configuration = mink.Configuration(model)
        self._frame = mink.FrameTask(
            TCP_SITE, "site", position_cost=1.0, orientation_cost=self.settings.rotation_cost, lm_damping=1e-3
        )
        self._posture = mink.PostureTask(model, cost=self.settings.posture_cost)
        self._free: list[mink.Limit] = [_HingeLimit(model)]
        self._guarded: list[mink.Limit] = [*self._free, _collision_limit(model, self.settings.guard_distance)]

    def tcp_pose(self, q: Floats) -> Floats:
        """Return ``T_world_tcp`` (4, 4) of a (6,) posture."""
        T_world_tcp: Floats = self._scene.tcp_poses(np.asarray(q, dtype=np.float64)[None])[0]
        return T_world_tcp

    def solve(self, T_world_tcp: Floats, seeds: Floats | Sequence[Floats], *, opening: float | None = None) -> IkResult:
        """Find a posture that puts the tcp at a pose: free of contact, elbow up, close to the first seed.

        Args:
            T_world_tcp: (4, 4) target.
            seeds: (6,) posture to stay close to, or several, (K, 6), the first of which it is [rad].
            opening: Distance between the pads for the collision check [m]; None for the open jaw.

        Returns:
            The best posture found; an unreachable pose has ``converged=False`` and the residual.

        Raises:
            ValueError: If the target is not a finite rigid transform or a seed not a finite (6,).
        """
        checked_pose(T_world_tcp)
        return self._solve(T_world_tcp, checked_postures("seeds", seeds), opening)

    def _solve(self, T_world_tcp: Floats, tried: Floats, opening: float | None) -> IkResult:
        """Solve for a pose from (K, 6) seeds, all of which have been checked."""
        target, q_near = mink.SE3.from_matrix(T_world_tcp), tried[0]
        best: IkResult | None = None
        iterations = 0
        for seed in chain(tried, self._restarts(T_world_tcp)):
            q, count = self._descend(target, seed)
            iterations += count
            result = self._judge(T_world_tcp, q, q_near, iterations, opening)
            if best is None or self._rank(result, q_near) < self._rank(best, q_near):
                best = result
            settled = best.ok or best.hopeless
            if settled and best.q[_ELBOW] > 0 and np.max(np.abs(best.q - q_near)[:-1]) < self.settings.near:
                break
        assert best is not None
        if best.converged and best.collision and not best.hopeless:
            q, count = self._descend(target, q_near, guarded=True)
            iterations += count
            guarded = self._judge(T_world_tcp, q, q_near, iterations, opening)
            best = guarded if guarded.ok else best
        return replace(best, iterations=iterations)

    def solve_grasp(self, T_world_tcp: Floats, q_near: Floats, *, opening: float | None = None) -> IkResult:
        """Like :meth:`solve` for a jaw that may be turned by half a turn about its approach.

        Tries the way that turns the tool less from ``q_near`` on, relative to the direction the arm points in; the
        other way is tried only where this one fails.
        """
        seeds = checked_postures("q_near", q_near)[:1]
        near = seeds[0]
        checked_pose(T_world_tcp)
        T_world_near = self.tcp_pose(near)
        R_world_aimed = rotation_about((0, 0, 1), turn_about_base(T_world_near, T_world_tcp)) @ T_world_near[:3, :3]
        ways = sorted(
            (T_world_tcp, T_world_tcp @ _JAW_FLIP), key=lambda T: float(rotation_angle(R_world_aimed.T @ T[:3, :3]))
        )
        first = self._solve(ways[0], seeds, opening)
        if first.ok or first.hopeless:
            return first
        second = self._solve(ways[1], seeds, opening)
        return min(first, second, key=lambda way: self._rank(way, near))

    def line(self, q_start: Floats, T_world_tcp_to: Floats) -> CartesianPath:
        """Track the straight line from the tcp's pose at ``q_start`` to another pose.

        Args:
            q_start: (6,) posture at the line's start [rad].
            T_world_tcp_to: (4, 4) pose at its end; the rotation between is about one axis at an even rate.
        """
        checked_pose(T_world_tcp_to)
        start = checked_postures("q_start", q_start)[0]
        path = [start]
        for T_world_tcp in interpolate_poses(self.tcp_pose(start), T_world_tcp_to, self.settings.line_spacing):
            q, _ = self._descend(mink.SE3.from_matrix(T_world_tcp), path[-1])
            if not self._reached(*pose_residual(self.tcp_pose(q), T_world_tcp)):
                return CartesianPath(q=np.array(path), complete=False)
            if np.max(np.abs(q - path[-1])) > self.settings.max_jump:
                return CartesianPath(q=np.array(path), complete=False, jumped=True)
            path.append(q)
        return CartesianPath(q=np.array(path), complete=True)

    def margin(self, q: Floats) -> float:
        """Return the smallest singular value of the tcp's Jacobian at a (6,) posture."""
        self._configuration.update(q)
        jacobian = self._configuration.get_frame_jacobian(TCP_SITE, "site")
        return float(np.linalg.svd(jacobian, compute_uv=False)[-1])

    def _descend(self, target: mink.SE3, seed: Floats, *, guarded: bool = False) -> tuple[Floats, int]:
        """Run one descent from a seed; return the (6,) posture where it ended and the number of iterations."""
        configuration, settings = self._configuration, self.settings
        limits = self._guarded if guarded else self._free
        max_step = settings.guarded_step if guarded else settings.max_step
        max_iterations = settings.max_iterations * (3 if guarded else 1)
        configuration.update(np.clip(seed, self._limits[:, 0], self._limits[:, 1]))
        self._frame.set_target(target)
        self._posture.set_target(configuration.q)
        for iteration in range(max_iterations):
            error = self._frame.compute_error(configuration)
            if self._reached(float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))):
                return configuration.q.copy(), iteration
            try:
                step = mink.solve_ik(configuration, [self._frame, self._posture], 1.0, "daqp", limits=limits)
            except mink.NoSolutionFound:  # the limits contradict each other here: this descent ends
                return configuration.q.copy(), iteration + 1
            largest = float(np.max(np.abs(step)))
            if largest < 1e-5:  # a local minimum
                return configuration.q.copy(), iteration + 1
            configuration.integrate_inplace(step * min(1.0, max_step / largest), 1.0)
        return configuration.q.copy(), max_iterations

    def _judge(
        self, T_world_tcp: Floats, q: Floats, q_near: Floats, iterations: int, opening: float | None
    ) -> IkResult:
        q = self._unwind(q, q_near)
        position_error, rotation_error = pose_residual(self.tcp_pose(q), T_world_tcp)
        return IkResult(
            q=q,
            converged=self._reached(position_error, rotation_error),
            position_error=position_error,
            rotation_error=rotation_error,
            iterations=iterations,
            contacts=tuple(self._scene.contacts(q, opening=opening)),
            margin=self.margin(q),
        )

    def _reached(self, position_error: float, rotation_error: float) -> bool:
        # 1e-9: the residual is measured twice, by mink's logarithm and by the angle, which differ in the last digits.
        within = position_error <= self.settings.position_tolerance + 1e-9
        return within and rotation_error <= self.settings.rotation_tolerance + 1e-9

    def _rank(self, result: IkResult, q_near: Floats) -> tuple[bool, bool, bool, float]:
        """Order results: reached, free, elbow up, then the joint that moves furthest (or the residual)."""
        distance = float(np.max(np.abs(result.q - q_near)))
        residual = result.position_error + self.settings.rotation_cost * result.rotation_error
        last = distance if result.converged else residual
        return not result.converged, result.collision, result.q[_ELBOW] <= 0, last

    def _unwind(self, q: Floats, q_near: Floats) -> Floats:
        """Turn each joint by whole turns to where it is nearest to ``q_near`` in its limits; the pan to (-pi, pi]."""
        turned = q[:, None] + _WRAPS
        allowed = (turned >= self._limits[:, :1]) & (turned <= self._limits[:, 1:])
        allowed[_PAN] &= (turned[_PAN] > -np.pi) & (turned[_PAN] <= np.pi)
        cost = np.where(allowed, np.abs(turned - q_near[:, None]), np.inf)
        unwound: Floats = turned[np.arange(DOF), np.argmin(cost, axis=1)]
        return unwound

    def _restarts(self, T_world_tcp: Floats) -> Iterator[Floats]:
        """Yield seeds: home turned towards the target, its wrist flips and turns, then perturbed ones."""
        aimed = self._home.copy()
        aimed[[_PAN, _WRIST_3]] += turn_about_base(self.tcp_pose(self._home), T_world_tcp)
        flipped = aimed + np.eye(DOF)[_WRIST_3] * np.pi
        flipped[_WRIST_2] *= -1
        flipped[_WRIST_1] += np.pi
        quarter = np.eye(DOF)[_WRIST_3] * np.pi / 2
        seeds = [aimed, aimed + quarter, aimed - quarter, flipped]
        rng = np.random.default_rng(0)
        spread = np.array([0.3, 0.3, 0.4, 0.8, 0.8, 1.5])
        seeds += [aimed + spread * rng.uniform(-1, 1, DOF) for _ in range(self.settings.restarts)]
        yield from seeds[: self.settings.restarts]


class _HingeLimit(mink.ConfigurationLimit):
    """mink's limit of the joints' positions for hinges that all have limits: the same bits, faster.

    Its rows do not depend on the posture, and the way between two postures is their difference.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        super().__init__(model)
        self._rows = np.vstack([np.eye(DOF), -np.eye(DOF)])

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> mink.Constraint:  # noqa: ARG002
        """Return the constraint that keeps a step from going ``gain`` of the way to any limit."""
        q = configuration.q
        return mink.Constraint(G=self._rows, h=self.gain * np.concatenate([self.upper - q, q - self.lower]))


def _collision_limit(model: mujoco.MjModel, distance: float) -> mink.CollisionAvoidanceLimit:
    """Keep forearm, wrist and gripper off everything that stands in the cell."""
    still = model.body_weldid[model.geom_bodyid] == 0
    moving = model.body_rootid[model.joint(ARM_JOINTS[_ELBOW]).bodyid[0]] == model.body_rootid[model.geom_bodyid]
    beyond_elbow = model.geom_bodyid >= model.joint(ARM_JOINTS[_ELBOW]).bodyid[0]
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    arm = np.flatnonzero(moving & beyond_elbow & ~still & collides).tolist()
    cell = np.flatnonzero(still & collides).tolist()
    return mink.CollisionAvoidanceLimit(
        model,
        [(arm, cell)],
        minimum_distance_from_collisions=distance,
        collision_detection_distance=0.12,  # further than any tip gets in one guarded step
        bound_relaxation=-3e-4,  # pushes back: at 0, pads over a flat floor creep into it from corner to corner
    )
