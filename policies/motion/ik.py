"""Inverse kinematics of the arm: one pose, or a straight line of poses, to joint positions.

The solver descends from several seeds. A pose fixes the gripper, so collision avoidance can only choose between the
arm's postures, and it makes an iteration several times as expensive. Hence it comes last: solve without it, ask the
scene for contacts, and only then solve with it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import mink
import numpy as np

from binpick_env.cell.robot import HOME
from perception.geometry import Floats, make_transform, require_shape, rotation_about, rotation_angle
from policies.motion.differential_ik import DifferentialIk
from policies.motion.ik_settings import IkSettings
from policies.motion.planning_scene import DOF, Contact, PlanningScene
from policies.motion.targets import checked_pose, checked_postures, interpolate_poses, pose_residual, turn_about_base

_WRAPS = 2 * np.pi * np.array([-1.0, 0.0, 1.0])
_JAW_FLIP = make_transform(np.diag([-1.0, -1.0, 1.0]))  # half a turn about the approach: the same grasp
_PAN, _ELBOW, _WRIST_1, _WRIST_2, _WRIST_3 = 0, 2, 3, 4, 5


@dataclass(frozen=True, eq=False, kw_only=True)
class IkResult:
    """The best posture found for a pose.

    Attributes:
        q: (6,) joint positions [rad].
        converged: Whether the pose is reached within the tolerances.
        position_error: Distance of the tcp from the target [m].
        rotation_error: Angle between tcp and target [rad].
        iterations: Number of iterations of all descents together.
        contacts: Contacts of the posture with the cell and with the arm itself, deepest first.
        min_singular_value: Smallest singular value of the tcp's Jacobian, metres and radians mixed; 0 at a singularity.
    """

    q: Floats
    converged: bool
    position_error: float
    rotation_error: float
    iterations: int
    contacts: tuple[Contact, ...]
    min_singular_value: float

    @property
    def collision(self) -> bool:
        """Whether the posture touches anything."""
        return bool(self.contacts)

    @property
    def gripper_collides(self) -> bool:
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
        q: (S, 6) joint positions from the line's start to its end, or to the last sample before a failure [rad].
        complete: Whether the line's end was reached.
        jumped: Whether the path ended because a joint would have jumped; otherwise a pose was out of reach.
    """

    q: Floats
    complete: bool
    jumped: bool = False


class IkSolver:
    """Finds postures for poses of the tcp. Deterministic: the same call gives the same bits.

    It holds the scene, the settings and the home posture, none of which changes.

    - :meth:`solve` finds a posture for one pose, :meth:`solve_grasp` for a grasp, which two poses reach.
    - :meth:`line` tracks a straight line.
    - :meth:`tcp_pose` is the forward direction.
    """

    def __init__(self, scene: PlanningScene, settings: IkSettings | None = None, *, home: Floats = HOME) -> None:
        """Prepare the descents.

        Args:
            scene: Kinematics and collision queries of the cell.
            settings: Tolerances and effort; the defaults if None.
            home: (6,) posture that restarts are made from, elbow up [rad].
        """
        require_shape("home", np.asarray(home), (DOF,))
        self.settings = settings if settings is not None else IkSettings()
        self._scene = scene
        self._home = np.asarray(home, dtype=np.float64)
        self._limits = scene.limits
        self._differential = DifferentialIk(scene.arm_model, self._limits, self.settings)

    def tcp_pose(self, q: Floats) -> Floats:
        """Return ``T_world_tcp`` (4, 4) of a (6,) posture."""
        T_world_tcp: Floats = self._scene.tcp_poses(np.asarray(q, dtype=np.float64)[None])[0]
        return T_world_tcp

    # --- one pose --------------------------------------------------------------------------------------------------

    def solve(self, T_world_tcp: Floats, seeds: Floats | Sequence[Floats], *, opening: float | None = None) -> IkResult:
        """Find a posture that puts the tcp at a pose: free of contact, elbow up, close to the first seed.

        Args:
            T_world_tcp: (4, 4) target.
            seeds: (6,) posture to stay close to, or (K, 6) postures to start from, the first of which is the one to
                stay close to [rad].
            opening: Distance between the pads for the collision check [m]; None for the open jaw.

        Returns:
            The best posture found; an unreachable pose has ``converged=False`` and the residual.

        Raises:
            ValueError: The target is not a finite rigid transform, or a seed not a finite (6,).
        """
        checked_pose(T_world_tcp)
        return self._solve(T_world_tcp, checked_postures("seeds", seeds), opening)

    def solve_grasp(self, T_world_tcp: Floats, q_near: Floats, *, opening: float | None = None) -> IkResult:
        """Find a posture as :meth:`solve` does, for the pose or for the jaw turned by half a turn about its approach.

        The orientation that turns the tool less comes first, as seen from ``q_near`` and relative to the direction in
        which the arm points. The other one is tried only where the first fails.
        """
        seeds = checked_postures("q_near", q_near)[:1]
        near = seeds[0]
        checked_pose(T_world_tcp)
        T_world_near = self.tcp_pose(near)
        R_world_aimed = rotation_about((0, 0, 1), turn_about_base(T_world_near, T_world_tcp)) @ T_world_near[:3, :3]
        orientations = sorted(
            (T_world_tcp, T_world_tcp @ _JAW_FLIP), key=lambda T: float(rotation_angle(R_world_aimed.T @ T[:3, :3]))
        )
        first = self._solve(orientations[0], seeds, opening)
        if first.ok or first.gripper_collides:
            return first
        second = self._solve(orientations[1], seeds, opening)
        return min(first, second, key=lambda result: self._rank(result, near))

    def _solve(self, T_world_tcp: Floats, seeds: Floats, opening: float | None) -> IkResult:
        """Solve for a checked pose from checked (K, 6) seeds: without collision avoidance, and with it if need be."""
        target, q_near = mink.SE3.from_matrix(T_world_tcp), seeds[0]

        # The given seeds, then restarts, until a solution that nothing is likely to improve on.
        best: IkResult | None = None
        iterations = 0
        for seed in chain(seeds, self._restarts(T_world_tcp)):
            q, count = self._differential.descend(target, seed)
            iterations += count
            result = self._assess(T_world_tcp, q, q_near, opening)
            if best is None or self._rank(result, q_near) < self._rank(best, q_near):
                best = result
            final = best.ok or best.gripper_collides
            if final and best.q[_ELBOW] > 0 and np.max(np.abs(best.q - q_near)[:-1]) < self.settings.near:
                break
        assert best is not None

        # The pose is reached, but the arm touches something: another posture may not.
        if best.converged and best.collision and not best.gripper_collides:
            q, count = self._differential.descend(target, q_near, avoid_collisions=True)
            iterations += count
            avoiding = self._assess(T_world_tcp, q, q_near, opening)
            best = avoiding if avoiding.ok else best
        return replace(best, iterations=iterations)

    def _restarts(self, T_world_tcp: Floats) -> Iterator[Floats]:
        """Yield (6,) seeds: home turned towards the target, its wrist turned and flipped, then perturbed ones."""
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

    def _assess(self, T_world_tcp: Floats, q: Floats, q_near: Floats, opening: float | None) -> IkResult:
        """Return what is known of the posture in which a descent ended, but for the number of iterations."""
        q = self._unwind(q, q_near)
        position_error, rotation_error = pose_residual(self.tcp_pose(q), T_world_tcp)
        return IkResult(
            q=q,
            converged=self._differential.within_tolerances(position_error, rotation_error),
            position_error=position_error,
            rotation_error=rotation_error,
            iterations=0,
            contacts=tuple(self._scene.contacts(q, opening=opening)),
            min_singular_value=self._differential.min_singular_value(q),
        )

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

    # --- a line of poses -------------------------------------------------------------------------------------------

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
            q, _ = self._differential.descend(mink.SE3.from_matrix(T_world_tcp), path[-1])
            if not self._differential.within_tolerances(*pose_residual(self.tcp_pose(q), T_world_tcp)):
                return CartesianPath(q=np.array(path), complete=False)
            if np.max(np.abs(q - path[-1])) > self.settings.max_jump:
                return CartesianPath(q=np.array(path), complete=False, jumped=True)
            path.append(q)
        return CartesianPath(q=np.array(path), complete=True)
