"""The motions of an attempt: to the grasp, with the part to the tray, and home."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from binpick_env.cell.robot import HOME
from binpick_env.config import CellConfig
from perception.geometry import Floats, invert_transform, make_transform, transform_points
from perception.part import PartModel
from policies.grasping.gripper import PAD_SIZE, GripperModel
from policies.grasping.outcomes import Abstention, GraspCandidate
from policies.grasping.pushes import CLOSED_GAP
from policies.motion.ik import IkResult, IkSolver
from policies.motion.path_checker import HeightFunction
from policies.motion.planner import MotionPlanner, StraightLegs, Tool
from policies.motion.planning_scene import PlanningScene
from policies.motion.trajectory import Trajectory
from policies.picking.settings import PickerSettings

_SPARSE = 8  # every eighth of the gripper's points is checked where it has room
_OUTLINE_POINTS = 64  # vertices that stand for the carried part
_FLOOR = 0.002  # height of the fingertips above the bin's floor at which a press ends [m]
_LIFT_MARGIN = 0.01  # lift beyond the height at which the carried part clears the rim [m]


@dataclass(frozen=True, eq=False, kw_only=True)
class PutBack:
    """The motions that put a load back into the bin.

    Attributes:
        across: Motion to over the place.
        down: Straight way down to where the load is released, or as far as it rests on something.
        place_world: (3,) place of the load's middle at the end [m].
    """

    across: Trajectory
    down: Trajectory
    place_world: Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class DropPlaces:
    """Where a load may be let go.

    Attributes:
        world: (K, 2) places in the bin, best first, world frame [m].
        drop: Height of the load above the pile [m].
    """

    world: Floats
    drop: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Press:
    """The motions with which a push begins.

    Attributes:
        approach: Motion to above the part.
        down: Straight way down, on which the part is met.
    """

    approach: Trajectory
    down: Trajectory


class AttemptPlanner:
    """Plans the three motions of an attempt in one cell with one kind of part. No call depends on an earlier one."""

    def __init__(self, config: CellConfig, part: PartModel, gripper: GripperModel, settings: PickerSettings) -> None:
        """Compile the cell's planning models; about two seconds.

        Args:
            config: The cell.
            part: Kind of part that is carried.
            gripper: Surfaces of the gripper.
            settings: Speeds and distances.
        """
        self._config, self._gripper, self._settings = config, gripper, settings
        self._scene = PlanningScene(config)
        self._ik = IkSolver(self._scene, settings.ik)
        self._motion = MotionPlanner(self._scene, self._ik)
        self._outline = _farthest_points(np.asarray(part.mesh.vertices), _OUTLINE_POINTS)

    def reach(self, grasp: GraspCandidate, q_from: Floats) -> IkResult | Abstention:
        """Solve for the posture at a grasp, close to (6,) ``q_from`` [rad], or return why there is none.

        A posture nearer to the cell than a straight approach may come is refused, because the approach ends in it.
        """
        reached = self._ik.solve_grasp(grasp.T_world_tcp, q_from, opening=grasp.opening)
        if not reached.ok:
            return Abstention.IK_INFEASIBLE
        clearance = self._motion.settings.line_clearance
        near = self._scene.contacts(reached.q, opening=grasp.opening, clearance=clearance)
        return Abstention.NO_CLEAR_APPROACH if near else reached

    def approach(
        self, q_from: Floats, q_grasp: Floats, grasp: GraspCandidate, pile: HeightFunction
    ) -> Trajectory | None:
        """Plan across to the pre-grasp and straight in to the grasp; None if there is no free way.

        Args:
            q_from: (6,) start [rad].
            q_grasp: (6,) posture at the grasp, by :meth:`reach` [rad].
            grasp: The grasp.
            pile: Height of the pile.
        """
        tool = Tool(opening=grasp.opening, points_tcp=self._gripper.hull_points(grasp.opening))
        legs = StraightLegs(standoff=self._settings.standoff, speed=self._settings.approach_speed)
        return self._motion.plan_transfer(q_from, q_grasp, tool, legs, obstacle_height=pile).trajectory

    def carry(
        self,
        q_grasp: Floats,
        grasp: GraspCandidate,
        T_world_part: Floats,
        pile: HeightFunction,
        q_from: Floats | None = None,
    ) -> Trajectory | None:
        """Plan the lift and the way to the tray with the part in the jaw; None if there is no free way.

        The lift is slow where other parts seem to lie on this one, so that they slide off.

        Where the part leaves no way to the tray, the motion ends at home, which is above the tray; it is then checked
        for the gripper alone, and at full speed.

        Args:
            q_grasp: (6,) posture at the grasp [rad].
            grasp: The grasp.
            T_world_part: (4, 4) pose of the part before the lift.
            pile: Height of the pile.
            q_from: (6,) posture where the motion starts, with the part in the jaw [rad]; ``q_grasp`` if None.
        """
        part_tcp, tool = self._load(q_grasp, grasp, T_world_part)
        q_from = q_grasp if q_from is None else q_from
        covered = grasp.features["buried"] > self._settings.most_buried
        legs = StraightLegs(
            lift=self._motion.clearing_lift(q_from, tool) + _LIFT_MARGIN,
            speed=self._settings.slow_lift if covered else None,
        )
        q_release = self._release_posture(part_tcp)
        to_tray = self._motion.plan_transfer(
            q_from, q_release, tool, legs, obstacle_height=pile, scale=self._settings.carry_scale
        )
        if to_tray.trajectory is not None:
            return to_tray.trajectory
        return self._motion.plan_transfer(q_from, HOME, Tool(opening=grasp.width), legs).trajectory

    def put_back(
        self,
        q_from: Floats,
        q_grasp: Floats,
        grasp: GraspCandidate,
        T_world_part: Floats,
        pile: HeightFunction,
        places: DropPlaces,
    ) -> PutBack | None:
        """Plan with the load to over the first place that can be reached, and straight down; None if there is none.

        Args:
            q_from: (6,) start, with the load above the rim [rad].
            q_grasp: (6,) posture at the grasp [rad].
            grasp: The grasp.
            T_world_part: (4, 4) pose of the part before the lift.
            pile: Height of the pile.
            places: Where the load may be let go.
        """
        part_tcp, tool = self._load(q_grasp, grasp, T_world_part)
        T_world_tcp = self._ik.tcp_pose(q_from)
        lift = self._motion.clearing_lift(q_from, tool) + _LIFT_MARGIN
        height = float(T_world_tcp[2, 3]) + lift
        # As the gripper is now, and as it came out of the bin: it may have turned to where a wall is in its way.
        turns = [self._ik.tcp_pose(q)[:3, :3] for q in (q_from, q_grasp)]
        for (x, y), R_world_tcp in product(places.world, turns):
            points = tool.points_tcp @ R_world_tcp.T + np.array([x, y, 0.0])
            release = float((pile(points) - points[:, 2]).max()) + places.drop
            reached = self._ik.solve(make_transform(R_world_tcp, (x, y, height)), q_from, opening=grasp.width)
            if not reached.ok or release > height:
                continue
            legs = StraightLegs(lift=lift)
            scale = self._settings.doubles.scale
            across = self._motion.plan_transfer(q_from, reached.q, tool, legs, obstacle_height=pile, scale=scale)
            lowered = make_transform(R_world_tcp, (x, y, release))
            down = self._motion.plan_line(reached.q, lowered, tool, speed=self._settings.approach_speed, scale=scale)
            if across.trajectory is not None and down.trajectory is not None:
                place = np.array([x, y, release - places.drop]) + R_world_tcp @ part_tcp.mean(axis=0)
                return PutBack(across=across.trajectory, down=down.trajectory, place_world=place)
        return None

    def press(self, q_from: Floats, T_world_tips: Floats, pile: HeightFunction) -> Press | None:
        """Plan with the jaw closed to above a point, and from there straight down; None if there is no free way.

        The way down ends above the bin's floor, or where the settings say.

        Args:
            q_from: (6,) start [rad].
            T_world_tips: (4, 4) pose of the fingertips' ends at the point, axes as those of a grasp.
            pile: Height of the pile.
        """
        push = self._settings.push
        T_world_tcp = self._gripper.tcp_from_grasp(T_world_tips[None], np.array([CLOSED_GAP]))[0]
        T_world_above = make_transform(translation=(0, 0, push.above)) @ T_world_tcp
        # The fingertips' broad side reaches lower than their middle where they lean.
        lean = PAD_SIZE[0] / 2 * float(np.hypot(T_world_tips[2, 0], T_world_tips[2, 1]))
        over_floor = float(T_world_tips[2, 3]) - self._config.bin.wall - lean - _FLOOR
        depth = push.above + float(np.clip(over_floor, 0.0, push.depth))
        reached = self._ik.solve_grasp(T_world_above, q_from, opening=CLOSED_GAP)
        near = self._motion.settings.line_clearance
        if not reached.ok or self._scene.contacts(reached.q, opening=CLOSED_GAP, clearance=near):
            return None
        tool = Tool(opening=CLOSED_GAP, points_tcp=self._gripper.hull_points(CLOSED_GAP))
        legs = StraightLegs(standoff=self._settings.standoff, speed=self._settings.approach_speed)
        approach = self._motion.plan_transfer(q_from, reached.q, tool, legs, obstacle_height=pile).trajectory
        down = self.drag(reached.q, np.array([0.0, 0.0, -depth]), push.press_speed)
        return None if approach is None or down is None else Press(approach=approach, down=down)

    def drag(self, q_from: Floats, way_world: Floats, speed: float) -> Trajectory | None:
        """Plan a straight way of the closed jaw that may begin and end in contact; None if there is none.

        Args:
            q_from: (6,) start [rad].
            way_world: (3,) way of the tcp [m].
            speed: Share of the joints' velocity limit allowed.
        """
        goal = make_transform(translation=way_world) @ self._ik.tcp_pose(q_from)
        return self._motion.plan_line(q_from, goal, Tool(opening=CLOSED_GAP), escaping=True, speed=speed).trajectory

    def lowered(self, q_near: Floats, q_planned: Floats, depth: float) -> Floats | None:
        """Return the (6,) posture next to ``q_near`` with the tcp ``depth`` [m] under that of ``q_planned`` [rad].

        Contacts are not checked. None if there is no such posture near by.
        """
        goal = make_transform(translation=(0, 0, -depth)) @ self._ik.tcp_pose(q_planned)
        line = self._ik.line(q_near, goal)
        return line.q[-1] if line.complete else None

    def home(self, q_from: Floats) -> Trajectory | None:
        """Plan out of the bin and home with the jaw open from a (6,) posture [rad]; None if there is no free way."""
        tool = Tool(points_tcp=self._gripper.hull_points(0.0)[::_SPARSE])
        legs = StraightLegs(lift=self._motion.clearing_lift(q_from, tool))
        return self._motion.plan_transfer(q_from, HOME, tool, legs).trajectory

    def _load(self, q_grasp: Floats, grasp: GraspCandidate, T_world_part: Floats) -> tuple[Floats, Tool]:
        """Return the (P, 3) points of the carried part in the tcp frame [m], and the jaw with them."""
        part_tcp = transform_points(invert_transform(self._ik.tcp_pose(q_grasp)) @ T_world_part, self._outline)
        jaw_tcp = self._gripper.hull_points(grasp.width)[::_SPARSE]
        return part_tcp, Tool(opening=grasp.width, points_tcp=np.vstack([part_tcp, jaw_tcp]))

    def _release_posture(self, part_tcp: Floats) -> Floats:
        """Return the (6,) posture over the tray in which (P, 3) points of the carried part hang lowest; else home."""
        tray = self._config.tray
        hang = max(float(part_tcp[:, 2].max()), float(self._gripper.tip_z(0.0)))
        R_world_tcp = self._ik.tcp_pose(HOME)[:3, :3]
        z = tray.wall + self._settings.release_height + hang
        T_world_tcp = make_transform(R_world_tcp, (*tray.position, max(z, tray.wall + tray.inner_size[2])))
        reached = self._ik.solve(T_world_tcp, HOME)
        return reached.q if reached.ok else HOME


def _farthest_points(points: Floats, count: int) -> Floats:
    """Return at most ``count`` of (N, 3) points by farthest-point sampling."""
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[chosen]
