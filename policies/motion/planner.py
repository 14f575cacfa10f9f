"""Timed motions between two postures: lift, traverse, descend. A failure is a value with its reason."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from perception.geometry import Floats, make_transform, require_shape
from policies.motion.ik import IkSolver
from policies.motion.path_checker import HeightFunction, PathChecker
from policies.motion.planning_scene import PlanningScene
from policies.motion.targets import checked_postures
from policies.motion.trajectory import JointPath, Trajectory, join, leg, smooth_path, time_path


class PlanFailure(StrEnum):
    """Why there is no motion."""

    IK = "ik"  # a straight line leaves the arm's reach
    JUMP = "jump"  # a straight line passes a singularity, where a joint would jump
    COLLISION = "collision"  # every path that was tried touches something
    INFEASIBLE_TIMING = "infeasible_timing"  # no timing obeys the limits


@dataclass(frozen=True, kw_only=True)
class PlannerSettings:
    """How motions are planned."""

    clearance: float = 0.01  # distance of the robot from the cell while it traverses [m]
    line_clearance: float = 0.0015  # the same on straight lines, which end in narrow places [m]
    escape_depth: float = 0.004  # penetration allowed where a motion sets out, since simulated contacts are soft [m]
    pile_clearance: float = 0.015  # height of the tool's points above pile, rim and tray while it traverses [m]
    via_heights: tuple[float, ...] = (0.06, 0.12, 0.20)  # heights of via points above start and goal, in turn [m]
    extensions: tuple[float, ...] = (0.0, 0.05, 0.1)  # lengths added to the standoff, in turn, until there is a way [m]
    line_speed: float = 1.0  # share of the velocity limit allowed on straight lines

    def __post_init__(self) -> None:
        for name in ("clearance", "line_clearance", "escape_depth", "pile_clearance", "via_heights", "extensions"):
            if np.min(getattr(self, name), initial=0.0) < 0:
                raise ValueError(f"{name} must be at least 0, got {getattr(self, name)}")
        if not 0 < self.line_speed <= 1:
            raise ValueError(f"line_speed must be in (0, 1], got {self.line_speed}")


@dataclass(frozen=True, eq=False, kw_only=True)
class Tool:
    """Gripper and carried part, as far as motions must clear them.

    Attributes:
        opening: Distance between the pads [m]; None for the open jaw.
        points_tcp: (P, 3) points on the gripper and on a carried part, tcp frame [m].
    """

    opening: float | None = None
    points_tcp: Floats = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        require_shape("points_tcp", self.points_tcp, (None, 3))


@dataclass(frozen=True, kw_only=True)
class StraightLegs:
    """The straight lines of the tcp with which a transfer begins and ends.

    Attributes:
        lift: Length of the first line, along the world's z [m]; there is none if 0.
        standoff: Length of the last line, along the goal's approach (tcp z) [m]; there is none if 0. The planner
            lengthens it where the given length leaves no way to its beginning.
        speed: Share of the arm's velocity limit allowed on both lines; the planner settings' ``line_speed`` if None.
    """

    lift: float = 0.0
    standoff: float = 0.0
    speed: float | None = None

    def __post_init__(self) -> None:
        if self.lift < 0 or self.standoff < 0:
            raise ValueError(f"lift and standoff must be at least 0, got {self.lift} and {self.standoff}")


@dataclass(frozen=True, eq=False, kw_only=True)
class MotionPlan:
    """A timed motion, or the reason why there is none.

    Attributes:
        trajectory: Motion whose marks are the ends of its legs; None if planning failed.
        failure: Kind of failure; None if there is a motion.
        detail: Failure in words.
    """

    trajectory: Trajectory | None = None
    failure: PlanFailure | None = None
    detail: str = ""

    @property
    def ok(self) -> bool:
        """Whether there is a motion."""
        return self.trajectory is not None


class MotionPlanner:
    """Plans motions of the arm in its cell. Deterministic; no call depends on an earlier one."""

    def __init__(self, scene: PlanningScene, ik: IkSolver, settings: PlannerSettings | None = None) -> None:
        """Keep the scene and the solver; the limits on joint velocity, acceleration and jerk are the scene's."""
        self.settings = settings if settings is not None else PlannerSettings()
        self._scene, self._ik = scene, ik
        self._limits = scene.config.robot
        self._checker = PathChecker(scene)

    def plan_line(
        self,
        q_from: Floats,
        T_world_tcp_to: Floats,
        tool: Tool,
        *,
        escaping: bool = False,
        speed: float | None = None,
        scale: float = 1.0,
    ) -> MotionPlan:
        """Plan a straight line of the tcp.

        Args:
            q_from: (6,) start [rad].
            T_world_tcp_to: (4, 4) goal.
            tool: Jaw and carried part.
            escaping: Whether the line leads away from contacts; penetration up to ``escape_depth`` is then allowed.
            speed: Share of the velocity limit allowed on the line; the settings' ``line_speed`` if None.
            scale: Share of the limits on velocity, acceleration and jerk used.
        """
        line = self._line(q_from, T_world_tcp_to, speed)
        if isinstance(line, MotionPlan):
            return line
        collision = self._line_collision(line, tool, escaping=escaping)
        return collision if collision is not None else self._timed([line], scale)

    def plan_transfer(
        self,
        q_from: Floats,
        q_to: Floats,
        tool: Tool,
        legs: StraightLegs | None = None,
        *,
        obstacle_height: HeightFunction | None = None,
        scale: float = 1.0,
    ) -> MotionPlan:
        """Plan a motion straight up, across, and straight in along the goal's approach, without a stop in between.

        Args:
            q_from: (6,) start [rad].
            q_to: (6,) goal [rad].
            tool: Jaw and carried part; its points are checked on the way across only.
            legs: Straight lines at both ends; none if None.
            obstacle_height: Surface of the pile, without what is carried; no pile if None.
            scale: Share of the limits on velocity, acceleration and jerk used on the whole motion.

        Returns:
            The plan; its trajectory has three marks: lifted, before the goal, and at the goal.
        """
        q_from, q_to = checked_postures("q_from", q_from)[0], checked_postures("q_to", q_to)[0]
        legs = legs if legs is not None else StraightLegs()
        up = self._line(q_from, make_transform(translation=(0, 0, legs.lift)) @ self._ik.tcp_pose(q_from), legs.speed)
        if isinstance(up, MotionPlan):
            return up
        first_failure: MotionPlan | None = None
        for further in self.settings.extensions if legs.standoff > 0 else (0.0,):
            back = make_transform(translation=(0, 0, -legs.standoff - further))
            plan = out = self._line(q_to, self._ik.tcp_pose(q_to) @ back, legs.speed)
            if not isinstance(out, MotionPlan):
                into = leg(out.q[::-1].copy(), float(out.speed[0]))
                across = self._across(up, into, tool, obstacle_height)
                plan = across if isinstance(across, MotionPlan) else self._timed([up, across, into], scale)
            assert isinstance(plan, MotionPlan)
            if plan.ok:
                return plan
            first_failure = first_failure or plan
        assert first_failure is not None
        return first_failure

    def clearing_lift(self, q: Floats, tool: Tool) -> float:
        """Return how far to lift [m] until the tool's lowest point clears the bin's rim; 0 if it does already."""
        T_world_tcp = self._ik.tcp_pose(q)
        points = np.vstack([np.zeros((1, 3)), tool.points_tcp])
        lowest = float(np.min(points @ T_world_tcp[2, :3])) + T_world_tcp[2, 3]
        return max(0.0, self._scene.rim + self.settings.pile_clearance + 0.005 - float(lowest))

    def _line(self, q_from: Floats, T_world_tcp_to: Floats, speed: float | None) -> JointPath | MotionPlan:
        line = self._ik.line(q_from, T_world_tcp_to)
        if line.complete:
            return leg(line.q, self.settings.line_speed if speed is None else speed)
        failure = PlanFailure.JUMP if line.jumped else PlanFailure.IK
        return MotionPlan(failure=failure, detail=f"the line breaks off after {len(line.q)} samples")

    def _across(
        self, up: JointPath, into: JointPath, tool: Tool, obstacle_height: HeightFunction | None
    ) -> JointPath | MotionPlan:
        """Find a free way from the end of one straight leg to the beginning of another."""
        collision = self._line_collision(up, tool, escaping=len(up.q) > 1) or self._line_collision(into, tool)
        if collision is not None:
            return collision
        detail = ""
        for waypoints in self._routes(up.q[-1], into.q[0]):
            knots = smooth_path(
                waypoints,
                tangent_from=up.q[-1] - up.q[-2] if len(up.q) > 1 else None,
                tangent_to=into.q[1] - into.q[0] if len(into.q) > 1 else None,
            )
            verdict = self._checker.check(
                knots,
                opening=tool.opening,
                clearance=self.settings.clearance,
                points_tcp=tool.points_tcp,
                obstacle_height=obstacle_height,
                pile_clearance=self.settings.pile_clearance,
            )
            if verdict.free:
                return leg(knots)
            detail = verdict.reason
        return MotionPlan(failure=PlanFailure.COLLISION, detail=f"no way across: {detail}")

    def _routes(self, q_start: Floats, q_end: Floats) -> Iterator[Floats]:
        """Yield (V, 6) waypoints: the direct way, then over a point above the goal, then over both ends."""
        yield np.vstack([q_start, q_end])
        for height in self.settings.via_heights:
            above_start, above_end = (self._raised(q, height) for q in (q_start, q_end))
            if above_end is not None:
                yield np.vstack([q_start, above_end, q_end])
            if above_start is not None:
                yield np.vstack([q_start, above_start, q_end])
            if above_start is not None and above_end is not None:
                yield np.vstack([q_start, above_start, above_end, q_end])

    def _raised(self, q: Floats, height: float) -> Floats | None:
        result = self._ik.solve(make_transform(translation=(0, 0, height)) @ self._ik.tcp_pose(q), q)
        return result.q if result.ok else None

    def _line_collision(self, line: JointPath, tool: Tool, *, escaping: bool = False) -> MotionPlan | None:
        """Return the failure of a straight leg that touches the cell; None if it is free."""
        clearance = -self.settings.escape_depth if escaping else self.settings.line_clearance
        verdict = self._checker.check(line.q, opening=tool.opening, clearance=clearance)
        if verdict.free:
            return None
        return MotionPlan(failure=PlanFailure.COLLISION, detail=f"on the line: {verdict.reason}")

    def _timed(self, legs: list[JointPath], scale: float) -> MotionPlan:
        trajectory = time_path(join(legs), self._limits, scale=scale)
        if trajectory is None:
            return MotionPlan(failure=PlanFailure.INFEASIBLE_TIMING, detail="toppra found no timing within the limits")
        return MotionPlan(trajectory=trajectory)
