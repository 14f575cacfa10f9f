"""The mink picker: choose a grasp, approach, close, lift, verify, carry, release, and say what came of it."""

import time
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from binpick_env.cell.delivery import Delivery
from binpick_env.cell.robot import HOME
from binpick_env.env import BinPickEnv
from perception.geometry import Floats, invert_transform, make_transform, transform_points
from policies.grasping.clearance import RankSettings, RankStats, rank_grasps
from policies.grasping.failed_grasps import FailedGrasps
from policies.grasping.grasps import sample_grasps
from policies.grasping.gripper import gripper_model
from policies.grasping.observed_scene import SeenScene
from policies.grasping.outcomes import Abstention, GraspCandidate, GraspOutcome, PickResult
from policies.motion.ik import IkResult, IkSolver
from policies.motion.path_checker import HeightFunction
from policies.motion.planner import MotionPlanner, StraightLegs, Tool
from policies.motion.planning_scene import PlanningScene
from policies.motion.trajectory import Trajectory
from policies.picking.execution import Execution, ExecutionSettings

_SPARSE = 8  # every so many of the gripper's points are checked where it has room
ExecutionMaker = Callable[[BinPickEnv, ExecutionSettings], Execution]
T_SENSE = 0.5  # nominal exposure of a structured-light camera [s]


@dataclass(frozen=True, kw_only=True)
class PickerSettings:
    """How the picker plans. Lengths [m]."""

    rank: RankSettings = field(default_factory=RankSettings)
    execution: ExecutionSettings = field(default_factory=ExecutionSettings)
    grasps_tried: int = 40  # for IK and a free path, best first, before the picker abstains
    standoff: float = 0.06  # length of the straight approach
    approach_speed: float = 0.25  # share of the joints' velocity limit on straight lines
    carry_scale: float = 0.7  # share of velocity and acceleration limits with a part in the jaw
    release_height: float = 0.03  # of the carried part's lowest point above the tray's floor
    empty_gap: float = 0.0015  # between the pads; a jaw closed further holds nothing


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan:
    """A grasp with the motion towards it.

    Attributes:
        grasp: On a candidate of the frame it was planned on.
        q_grasp: (6,) posture in which the pads close [rad].
        approach: From where the arm is to that posture.
        frame_id: Number of that frame.
    """

    grasp: GraspCandidate
    q_grasp: Floats
    approach: Trajectory
    frame_id: int


class ScriptedPicker:
    """Picks the best-ranked grasp that the arm can reach. Works on the candidates and the frame of the environment.

    :meth:`pick` is :meth:`grasps`, :meth:`plan` until one of them can be reached, and :meth:`execute`; whoever chooses
    otherwise calls these. What the policy decides on is what a real cell has: frame, candidates, joint and gripper
    positions, the force at the tool. The truth of the physics decides nothing: it ends the wait for the verdict, and
    names the outcome.
    """

    def __init__(
        self, env: BinPickEnv, settings: PickerSettings | None = None, execution: ExecutionMaker = Execution
    ) -> None:
        """Load gripper, grasps and planner for the environment's part and cell; a few seconds for a new part.

        Args:
            env: The unwrapped cell.
            settings: Defaults if None.
            execution: Makes what steps the cell through an attempt.

        Raises:
            ValueError: There is no grasp on the part.
        """
        self._env, self._execution = env, execution
        self.settings = settings or PickerSettings()
        self.gripper = gripper_model()
        self.grasp_set = sample_grasps(env.part.model)
        if len(self.grasp_set) == 0:
            raise ValueError(
                f"the jaw (stroke {1000 * self.gripper.stroke:.0f} mm) finds no grasp on {env.part.model.name!r}: "
                "it needs two opposite faces that its pads can reach"
            )
        self._scene = PlanningScene(env.config)
        self._ik = IkSolver(self._scene)
        self._planner = MotionPlanner(self._scene, self._ik)
        self._outline = _outline(np.asarray(env.part.model.mesh.vertices))
        self.rank_stats = RankStats()
        self._compiled = False
        self._seen: SeenScene | None = None
        self.reset()

    def executing(self, execution: ExecutionMaker) -> "ScriptedPicker":
        """Return a picker that executes in another way; it plans the same, and remembers failures of its own."""
        other = copy(self)
        other._execution = execution
        other.reset()
        return other

    def reset(self) -> None:
        """Forget the last bin."""
        self.failed = FailedGrasps(reach=self._env.part.model.d_max / 4)

    def pick(self) -> PickResult:
        """Make one decision on the last frame: an executed attempt, or an abstention."""
        if not self._compiled:  # the kernels' compilation is no part of a decision's time
            self._decide()
            self._compiled, self._seen = True, None
        started = time.perf_counter()
        plan = self._decide()
        compute = time.perf_counter() - started + self._env.perception_time
        if isinstance(plan, Abstention):
            return PickResult(abstention=plan, t_sense=T_SENSE, t_compute=compute, frame_id=self._env.frame_id)
        result = self.execute(plan)
        return replace(result, t_compute=compute + result.t_compute)

    # --- planning --------------------------------------------------------------------------------------------------

    def seen(self) -> SeenScene:
        """Return what the last frame shows; it is laid out when it is first asked for."""
        env, last = self._env, self._seen
        if last is None or last.frame is not env.frame or last.candidates is not env.candidates:
            last = self._seen = SeenScene.from_frame(
                env.frame,
                env.candidates,
                env.workspace,
                self.grasp_set.surface,
                cell=self.settings.rank.cell,
                wall=env.config.bin.wall,
            )
        return last

    def grasps(self) -> list[GraspCandidate]:
        """Return the grasps on the last frame's candidates that are clear of the scene, best first.

        Those that failed before are left out, others on the same parts come last. Nobody has asked yet whether the arm
        reaches them.
        """
        ranked, self.rank_stats = rank_grasps(self.seen(), self.grasp_set, self.gripper, self.settings.rank)
        return self.failed.fresh_first(ranked, self._env.candidates)

    def reach(self, grasp: GraspCandidate) -> IkResult | Abstention:
        """Solve for the posture at a grasp, or say why there is none that the arm could come straight in to.

        Note:
            0.7 ms, against 10 ms for :meth:`plan`, which still fails for one in fifty of those that are reached (14 of
            599 on tees, brackets and part_a).
        """
        reached = self._ik.solve_grasp(grasp.T_world_tcp, self._env.simulation.target, opening=grasp.opening)
        if not reached.ok:
            return Abstention.IK_INFEASIBLE
        clearance = self._planner.settings.line_clearance  # the way in ends here
        tight = self._scene.contacts(reached.q, opening=grasp.opening, clearance=clearance)
        return Abstention.NO_CLEAR_APPROACH if tight else reached

    def plan(self, grasp: GraspCandidate) -> Plan | Abstention:
        """Plan the motion to a grasp, or say why there is none."""
        env, settings = self._env, self.settings
        reached = self.reach(grasp)
        if isinstance(reached, Abstention):
            return reached
        approach = self._planner.plan_transfer(
            env.simulation.target,
            reached.q,
            Tool(opening=grasp.opening, points_tcp=self.gripper.hull_points(grasp.opening)),
            StraightLegs(standoff=settings.standoff, speed=settings.approach_speed),
            obstacle_height=self._pile_height(),
        )
        if approach.trajectory is None:
            return Abstention.NO_CLEAR_APPROACH
        return Plan(grasp=grasp, q_grasp=reached.q, approach=approach.trajectory, frame_id=env.frame_id)

    def _decide(self) -> Plan | Abstention:
        if not self._env.candidates:
            return Abstention.NO_CANDIDATE
        reasons = set()
        for grasp in self.grasps()[: self.settings.grasps_tried]:
            plan = self.plan(grasp)
            if isinstance(plan, Plan):
                return plan
            reasons.add(plan)
        unreached = reasons == {Abstention.IK_INFEASIBLE}
        return Abstention.IK_INFEASIBLE if unreached else Abstention.NO_CLEAR_APPROACH

    def _pile_height(self) -> HeightFunction:
        """Return the seen surface's world height [m] under (P, 3) world points."""
        scene = self.seen().heights
        floor = float(self._env.workspace.T_world_bin[2, 3])

        def height(points_world: Floats) -> Floats:
            return scene.highest_at(transform_points(scene.T_bin_world, points_world)) + floor

        return height

    # --- execution -------------------------------------------------------------------------------------------------

    def execute(self, plan: Plan) -> PickResult:
        """Make the attempt and say what came of it; of the computing, ``t_compute`` has what was done on the way.

        Raises:
            ValueError: Another frame has been taken since the plan was made.
        """
        env = self._env
        if plan.frame_id != env.frame_id:
            raise ValueError(f"the plan is for frame {plan.frame_id}, but the last one is {env.frame_id}: plan again")
        began, events_before, strays = env.simulation.time, len(env.events), env.unjudged()
        execution = self._execution(env, self.settings.execution)
        candidate = env.candidates[plan.grasp.candidate]
        planning = self._move(plan, execution, candidate.T_world_part)
        execution.await_judgement()
        # A part that was out of the bin already, and came to rest only now, is an earlier attempt's.
        kinds = [event.kind for event in env.events[events_before:] if event.part not in strays]
        outcome = execution.outcome(kinds)
        if outcome is not GraspOutcome.DELIVERED:
            self.failed.add(candidate.centre_world, plan.grasp.T_world_grasp)
        return PickResult(
            outcome=outcome,
            grasp=plan.grasp,
            part=candidate.part,
            delivered=kinds.count(Delivery.DELIVERED),
            t_sense=T_SENSE,
            t_compute=planning,
            t_motion=env.simulation.time - began,
            frame_id=plan.frame_id,
        )

    def _move(self, plan: Plan, execution: Execution, T_world_part: Floats) -> float:
        """Run the attempt and return the wall clock spent on planning on the way [s]."""
        settings = self.settings
        preshape = self.gripper.control(plan.grasp.opening)
        if not execution.follow(plan.approach, preshape, guard=True):
            return self._go_home(execution)
        execution.close()
        started = time.perf_counter()
        T_world_tcp = self._ik.tcp_pose(plan.q_grasp)
        carried = transform_points(invert_transform(T_world_tcp) @ T_world_part, self._outline)
        jaw = self.gripper.hull_points(plan.grasp.width)[::_SPARSE]
        tool = Tool(opening=plan.grasp.width, points_tcp=np.vstack([carried, jaw]))
        legs = StraightLegs(lift=self._planner.clearing_lift(plan.q_grasp, tool) + 0.01)
        release = self._release_posture(carried)
        carry = self._planner.plan_transfer(
            plan.q_grasp,
            release,
            tool,
            legs,
            obstacle_height=self._pile_height(),
            scale=settings.carry_scale,
        )
        if carry.trajectory is None:  # with the part in the jaw, stricter clearances than the lone gripper's
            carry = self._planner.plan_transfer(plan.q_grasp, HOME, Tool(opening=plan.grasp.width), legs)
        planning = time.perf_counter() - started
        if carry.trajectory is None:
            execution.release()
            execution.retrace()
            return planning
        if not execution.carry(carry.trajectory, self.gripper.control(settings.empty_gap)):
            return planning + self._go_home(execution)
        execution.release()
        return planning + self._go_home(execution)

    def _release_posture(self, carried_tcp: Floats) -> Floats:
        """Return the (6,) posture above the tray from which the carried part has the least to fall."""
        tray = self._env.config.tray
        hang = max(float(carried_tcp[:, 2].max()), float(self.gripper.tip_z(0.0)))
        at_home = self._ik.tcp_pose(HOME)
        z = tray.wall + self.settings.release_height + hang
        T_world_tcp = make_transform(at_home[:3, :3], (*tray.position, max(z, tray.wall + tray.inner_size[2])))
        reached = self._ik.solve(T_world_tcp, HOME)
        return reached.q if reached.ok else HOME

    def _go_home(self, execution: Execution) -> float:
        """Lift out of the bin and go home with the jaw open; return the wall clock of planning [s]."""
        if execution.leap_home():
            return 0.0
        started = time.perf_counter()
        q = self._env.simulation.target.copy()
        tool = Tool(points_tcp=self.gripper.hull_points(0.0)[::_SPARSE])
        legs = StraightLegs(lift=self._planner.clearing_lift(q, tool))
        plan = self._planner.plan_transfer(q, HOME, tool, legs)
        planning = time.perf_counter() - started
        if plan.trajectory is None:
            execution.retrace()
        else:
            execution.follow(plan.trajectory, 0.0)
        return planning


def _outline(vertices: Floats, count: int = 64) -> Floats:
    """Return at most ``count`` of (N, 3) vertices, spread by farthest-point sampling: the part's extent."""
    chosen = [int(np.argmax(np.linalg.norm(vertices - vertices.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(vertices - vertices[chosen[0]], axis=1)
    while len(chosen) < min(count, len(vertices)):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(vertices - vertices[chosen[-1]], axis=1))
    return vertices[chosen]
