"""The mink picker: choose a grasp, approach, close, lift, verify, carry, release, and say what came of it."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from binpick_env.env import BinPickEnv
from binpick_env.outcomes import Delivery
from binpick_env.robot import HOME
from perception.geometry import Floats, invert_transform, make_transform, transform_points
from policies.clearance import RankSettings, RankStats, rank_grasps
from policies.execution import Execution, ExecutionSettings
from policies.grasps import sample_grasps
from policies.gripper import gripper_model
from policies.heightmap import HeightMap
from policies.ik import IkSolver
from policies.motion import Trajectory
from policies.outcomes import Abstention, GraspCandidate, GraspOutcome, PickResult
from policies.planner import MotionPlanner, Tool
from policies.planning_scene import PlanningScene

_SPARSE = 8  # every so many of the gripper's points are checked where it has room
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
class _Plan:
    """A grasp with the motion towards it."""

    grasp: GraspCandidate
    q_grasp: Floats
    approach: Trajectory


@dataclass(frozen=True, eq=False, kw_only=True)
class _Failure:
    """What was tried in vain: the part's centre (3,) [m] and the grasp (4, 4), world frame."""

    centre_world: Floats
    T_world_grasp: Floats


class ScriptedPicker:
    """Picks the best-ranked grasp that the arm can reach. Works on the candidates and the frame of the environment.

    What the policy decides on is what a real cell has: frame, candidates, joint and gripper positions, the force at the
    tool. The truth of the physics decides nothing: it ends the wait for the verdict, and names the outcome.
    """

    def __init__(self, env: BinPickEnv, settings: PickerSettings | None = None) -> None:
        """Load gripper, grasps and planner for the environment's part and cell; a few seconds for a new part.

        Raises:
            ValueError: There is no grasp on the part.
        """
        self._env = env
        self._settings = settings or PickerSettings()
        self._gripper = gripper_model()
        self._grasps = sample_grasps(env.part.model)
        if len(self._grasps) == 0:
            raise ValueError(
                f"the jaw (stroke {1000 * self._gripper.stroke:.0f} mm) finds no grasp on {env.part.model.name!r}: "
                "it needs two opposite faces that its pads can reach"
            )
        scene = PlanningScene(env.config)
        self._ik = IkSolver(scene)
        self._planner = MotionPlanner(scene, self._ik)
        self._outline = _outline(np.asarray(env.part.model.mesh.vertices))
        self.rank_stats = RankStats()
        self._compiled = False
        self.reset()

    def reset(self) -> None:
        """Forget the last bin."""
        self._failed: list[_Failure] = []

    def pick(self) -> PickResult:
        """Make one decision on the last frame: an executed attempt, or an abstention."""
        env, frame_id = self._env, self._env.frame_id
        if not self._compiled:  # the kernels' compilation is no part of a decision's time
            self._plan()
            self._compiled = True
        started = time.perf_counter()
        plan = self._plan()
        compute = time.perf_counter() - started + env.perception_time
        if isinstance(plan, Abstention):
            return PickResult(abstention=plan, t_sense=T_SENSE, t_compute=compute, frame_id=frame_id)
        began, events_before, strays = env.simulation.time, len(env.events), env.unjudged()
        execution = Execution(env, self._settings.execution)
        candidate = env.candidates[plan.grasp.candidate]
        planning = self._execute(plan, execution, candidate.T_world_part)
        execution.await_judgement()
        # A part that was out of the bin already, and came to rest only now, is an earlier attempt's.
        kinds = [event.kind for event in env.events[events_before:] if event.part not in strays]
        outcome = execution.outcome(kinds)
        if outcome is not GraspOutcome.DELIVERED:
            self._failed.append(_Failure(centre_world=candidate.centre_world, T_world_grasp=plan.grasp.T_world_grasp))
        return PickResult(
            outcome=outcome,
            grasp=plan.grasp,
            part=candidate.part,
            delivered=kinds.count(Delivery.DELIVERED),
            t_sense=T_SENSE,
            t_compute=compute + planning,
            t_motion=env.simulation.time - began,
            frame_id=frame_id,
        )

    # --- planning --------------------------------------------------------------------------------------------------

    def _plan(self) -> _Plan | Abstention:
        env, settings = self._env, self._settings
        if not env.candidates:
            return Abstention.NO_CANDIDATE
        ranked, self.rank_stats = rank_grasps(
            env.candidates,
            self._grasps,
            env.frame,
            env.workspace,
            self._gripper,
            settings.rank,
            wall=env.config.bin.wall,
        )
        if not ranked:
            return Abstention.NO_CLEAR_APPROACH
        height = self._pile_height()
        fresh = self._fresh_first(ranked)
        blocked = not fresh
        for grasp in fresh[: settings.grasps_tried]:
            reached = self._ik.solve_grasp(grasp.T_world_tcp, env.simulation.target, opening=grasp.opening)
            if not reached.ok:
                continue
            tool = Tool(opening=grasp.opening, points_tcp=self._gripper.hull_points(grasp.opening))
            approach = self._planner.plan_transfer(
                env.simulation.target,
                reached.q,
                tool,
                standoff=settings.standoff,
                obstacle_height=height,
                speed=settings.approach_speed,
            )
            if approach.trajectory is not None:
                return _Plan(grasp=grasp, q_grasp=reached.q, approach=approach.trajectory)
            blocked = True
        return Abstention.NO_CLEAR_APPROACH if blocked else Abstention.IK_INFEASIBLE

    def _fresh_first(self, ranked: list[GraspCandidate]) -> list[GraspCandidate]:
        """Leave out grasps that failed before, and put others on the parts that they failed on behind all else."""
        reach = self._env.part.model.d_max / 4
        centres = [self._env.candidates[grasp.candidate].centre_world for grasp in ranked]
        suspect = [any(np.linalg.norm(centre - f.centre_world) < reach for f in self._failed) for centre in centres]
        order = np.argsort(suspect, kind="stable")
        again = [any(_alike(grasp.T_world_grasp, f.T_world_grasp) for f in self._failed) for grasp in ranked]
        return [ranked[k] for k in order if not again[k]]

    def _pile_height(self) -> Callable[[Floats], Floats]:
        """Return the seen surface's world height [m] under (P, 3) world points."""
        env = self._env
        scene = HeightMap.from_frame(env.frame, env.workspace, wall=env.config.bin.wall)
        floor = float(env.workspace.T_world_bin[2, 3])

        def height(points_world: Floats) -> Floats:
            return scene.highest_at(transform_points(scene.T_bin_world, points_world)) + floor

        return height

    # --- execution -------------------------------------------------------------------------------------------------

    def _execute(self, plan: _Plan, execution: Execution, T_world_part: Floats) -> float:
        """Run the attempt and return the wall clock spent on planning on the way [s]."""
        settings = self._settings
        preshape = self._gripper.control(plan.grasp.opening)
        if not execution.follow(plan.approach, preshape, guard=True):
            return self._go_home(execution)
        execution.close()
        started = time.perf_counter()
        T_world_tcp = self._ik.tcp_pose(plan.q_grasp)
        carried = transform_points(invert_transform(T_world_tcp) @ T_world_part, self._outline)
        jaw = self._gripper.hull_points(plan.grasp.width)[::_SPARSE]
        tool = Tool(opening=plan.grasp.width, points_tcp=np.vstack([carried, jaw]))
        lift = self._planner.clearing_lift(plan.q_grasp, tool) + 0.01
        release = self._release_posture(carried)
        carry = self._planner.plan_transfer(
            plan.q_grasp,
            release,
            tool,
            lift=lift,
            obstacle_height=self._pile_height(),
            scale=settings.carry_scale,
        )
        if carry.trajectory is None:  # with the part in the jaw, stricter clearances than the lone gripper's
            carry = self._planner.plan_transfer(plan.q_grasp, HOME, Tool(opening=plan.grasp.width), lift=lift)
        planning = time.perf_counter() - started
        if carry.trajectory is None:
            execution.release()
            execution.retrace()
            return planning
        if not execution.carry(carry.trajectory, self._gripper.control(settings.empty_gap)):
            return planning + self._go_home(execution)
        execution.release()
        return planning + self._go_home(execution)

    def _release_posture(self, carried_tcp: Floats) -> Floats:
        """Return the (6,) posture above the tray from which the carried part has the least to fall."""
        tray = self._env.config.tray
        hang = max(float(carried_tcp[:, 2].max()), float(self._gripper.tip_z(0.0)))
        at_home = self._ik.tcp_pose(HOME)
        z = tray.wall + self._settings.release_height + hang
        T_world_tcp = make_transform(at_home[:3, :3], (*tray.position, max(z, tray.wall + tray.inner_size[2])))
        reached = self._ik.solve(T_world_tcp, HOME)
        return reached.q if reached.ok else HOME

    def _go_home(self, execution: Execution) -> float:
        """Lift out of the bin and go home with the jaw open; return the wall clock of planning [s]."""
        started = time.perf_counter()
        q = self._env.simulation.target.copy()
        tool = Tool(points_tcp=self._gripper.hull_points(0.0)[::_SPARSE])
        plan = self._planner.plan_transfer(q, HOME, tool, lift=self._planner.clearing_lift(q, tool))
        planning = time.perf_counter() - started
        if plan.trajectory is None:
            execution.retrace()
        else:
            execution.follow(plan.trajectory, 0.0)
        return planning


def _alike(T_a: Floats, T_b: Floats) -> bool:
    """Whether two grasps are one: tips within 8 mm, approach and jaw within 15 degrees, the jaw without a sign."""
    near = float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])) < 0.008
    cosine = np.cos(np.radians(15))
    return near and T_a[:3, 2] @ T_b[:3, 2] > cosine and abs(T_a[:3, 1] @ T_b[:3, 1]) > cosine


def _outline(vertices: Floats, count: int = 64) -> Floats:
    """Return at most ``count`` of (N, 3) vertices, spread by farthest-point sampling: the part's extent."""
    chosen = [int(np.argmax(np.linalg.norm(vertices - vertices.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(vertices - vertices[chosen[0]], axis=1)
    while len(chosen) < min(count, len(vertices)):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(vertices - vertices[chosen[-1]], axis=1))
    return vertices[chosen]
