"""The scripted picker: choose a grasp, approach, close, lift, verify, carry, release, and name the outcome."""

import time
from collections.abc import Callable
from copy import copy
from dataclasses import replace

import numpy as np

from binpick_env.candidates import PoseCandidate
from binpick_env.cell.delivery import Delivery
from binpick_env.cell.robot import HOME
from binpick_env.cell.wrist_force import WristForceSensor
from binpick_env.env import BinPickEnv
from binpick_env.episode import FrameState
from perception.geometry import Floats, transform_points
from policies.grasping.clearance import RankStats, rank_grasps
from policies.grasping.failed_grasps import FailedGrasps
from policies.grasping.grasps import sample_grasps, why_no_grasp
from policies.grasping.gripper import gripper_model
from policies.grasping.low_places import low_places
from policies.grasping.observed_scene import ObservedScene
from policies.grasping.outcomes import Abstention, GraspCandidate, GraspOutcome, PickResult, PushOutcome
from policies.grasping.pushes import Push, find_pushes
from policies.motion.ik import IkResult
from policies.motion.path_checker import HeightFunction
from policies.picking.attempt_planner import AttemptPlanner, DropPlaces, Press
from policies.picking.execution import Execution, ExecutionSettings
from policies.picking.extra_decisions import PER_PART, ExtraDecisions
from policies.picking.frame_ahead import FrameAhead
from policies.picking.load_check import LoadCheck
from policies.picking.load_image import gone_beside, image_of, mean_silhouette
from policies.picking.plan import Plan
from policies.picking.pusher import Pusher
from policies.picking.settings import PickerSettings

ExecutionMaker = Callable[[BinPickEnv, ExecutionSettings], Execution]
_WRIST_STREAM = 1  # number of the random stream of what is felt and seen in an attempt; the environment's is not used
T_SENSE = 0.5  # nominal exposure time of a structured-light camera [s]


class ScriptedPicker:
    """Picks the best-ranked grasp that the arm can reach, from the environment's last frame and its candidates.

    :meth:`pick` makes one decision, in three steps, which a selector may call one by one:

    1. :meth:`grasps` ranks the grasps that are clear of the scene.
    2. :meth:`plan` is asked for one grasp after the other, until there is a motion to one. It begins with
       :meth:`reach`, which is cheaper and fails for nearly all grasps that have no plan.
    3. :meth:`execute` makes the attempt: approach, close, lift, carry, release, go home, wait, name the outcome.

    Decisions use only what a real cell has: the frame, the candidates, joint and gripper positions, and the force at
    the tool. The simulation's truth ends the wait for the judgement, and names the outcome.

    Attributes:
        settings: How the picker plans.
        gripper: Geometry of the gripper.
        grasp_set: Grasps on this kind of part.
        failed: Failed attempts of the current bin; the only thing remembered from pick to pick.
        rank_stats: Where the last ranking lost grasps.
    """

    def __init__(
        self, env: BinPickEnv, settings: PickerSettings | None = None, execution: ExecutionMaker = Execution
    ) -> None:
        """Load gripper, grasps and planner for the environment's part and cell; a few seconds for a new part.

        Args:
            env: The unwrapped cell.
            settings: Ranking, planning and execution; the defaults if None.
            execution: Factory of the object that steps the cell through one attempt.

        Raises:
            ValueError: There is no grasp on the part.
        """
        self._env, self._execution = env, execution
        self.settings = settings or PickerSettings()
        jaw = env.config.robot.jaw
        self.gripper = gripper_model(jaw)
        self.grasp_set = sample_grasps(env.part.model, jaw=jaw)
        if len(self.grasp_set) == 0:
            raise ValueError(why_no_grasp(env.part.model, jaw=jaw))
        self._planner = AttemptPlanner(env.config, env.part.model, self.gripper, self.settings)
        self._pusher = Pusher(env, self._planner, self.gripper, self.settings)
        self._ahead = FrameAhead(env, self.settings.rank.cell)
        self.rank_stats = RankStats()
        self._seen: FrameState | None = None  # frame of the last decision
        self._last_scene: ObservedScene | None = None  # scene of the last frame that was asked for
        self.reset()

    def with_execution(self, execution: ExecutionMaker) -> "ScriptedPicker":
        """Return a picker that plans the same, executes in another way, and has failed attempts of its own."""
        other = copy(self)
        other._execution, other._ahead = execution, copy(self._ahead)
        other.reset()
        return other

    def reset(self) -> None:
        """Forget the failed attempts of the last bin."""
        d_max = self._env.part.model.d_max
        self.failed = FailedGrasps(radius=d_max / 4)
        self._extra = ExtraDecisions(radius=d_max / 2)
        self._rng = np.random.default_rng([max(self._env.np_random_seed, 0), _WRIST_STREAM])  # -1: a given generator
        self._ahead.reset()
        self._wrist = WristForceSensor(self._env.simulation, self.settings.doubles.force, self._rng)
        self._pushed: list[Push] = []  # pushes in this bin
        self._refused: ObservedScene | None = None  # scene of the last decision if it was an abstention

    def pick(self) -> PickResult:
        """Make one decision on the last frame: an executed attempt, an abstention, or a push.

        A push takes the place of a second abstention in a row, if the settings allow pushes.
        """
        homing = self._come_home()
        seen, self._seen = self._seen, self._env.episode.frame
        if seen is None:  # a first decision compiles kernels, which is no part of a decision's time
            self._decide()
            self._last_scene = None
        waited = 0.0 if seen is self._seen else self._env.simulation.time - self._seen.time
        started = time.perf_counter()
        plan = self._decide()
        gives_up = isinstance(plan, Abstention) and self._refused is not None and self.settings.push.enabled
        push = self._plan_push() if gives_up else None
        compute = time.perf_counter() - started + self._env.perception_time
        self._refused = self.observed_scene() if isinstance(plan, Abstention) and push is None else None
        if push is not None:
            result = self._push(*push)
        elif isinstance(plan, Abstention):
            result = PickResult(abstention=plan, t_sense=T_SENSE, frame_id=self._env.frame_id)
        else:
            result = self.execute(plan)
        self._extra.decided()
        return replace(
            result,
            t_motion=homing + result.t_motion,
            t_compute=compute + result.t_compute,
            t_concurrent=min(T_SENSE + compute, waited),
        )

    # --- decision --------------------------------------------------------------------------------------------------

    def _decide(self) -> Plan | Abstention:
        if not self._env.candidates:
            return Abstention.NO_CANDIDATE
        grasps = sorted(self.grasps(), key=self._obstructed)  # stable: the order stays among the others
        if self._refused is None:
            grasps = [grasp for grasp in grasps if not self._obstructed(grasp)]
        reasons = set()
        for grasp in grasps[: self.settings.grasps_tried]:
            plan = self.plan(grasp)
            if isinstance(plan, Plan):
                return plan
            reasons.add(plan)
        return Abstention.IK_INFEASIBLE if reasons == {Abstention.IK_INFEASIBLE} else Abstention.NO_CLEAR_APPROACH

    def _obstructed(self, grasp: GraspCandidate) -> bool:
        """Return whether other parts seem to lie on the target; they would come along."""
        return grasp.features["buried"] > self.settings.most_buried

    def grasps(self) -> list[GraspCandidate]:
        """Return the grasps on the last frame's candidates that are clear of the scene, best first.

        Grasps that failed before are left out; other grasps on the same parts come last. Parts that may be put back no
        more are left out unless they lie apart: with another part they would be lost. Whether the arm reaches the
        grasps is not checked.
        """
        ranked, self.rank_stats = rank_grasps(self.observed_scene(), self.grasp_set, self.gripper, self.settings.rank)
        entangled = [self._entangled(row) for row in range(len(self._env.candidates))]
        ranked = [grasp for grasp in ranked if not entangled[grasp.candidate]]
        return self.failed.without_failed(ranked, self._env.candidates)

    def _entangled(self, row: int) -> bool:
        """Return whether a candidate was put back with another part as often as it may be, and has one near it."""
        centres = np.stack([candidate.centre_world for candidate in self._env.candidates])
        if self._extra.times_put_back(centres[row]) < PER_PART:
            return False
        return int((np.linalg.norm(centres - centres[row], axis=1) < self._env.part.model.d_max).sum()) > 1

    def reach(self, grasp: GraspCandidate) -> IkResult | Abstention:
        """Solve for the posture at a grasp, or return why there is none that a straight approach could end in.

        Note:
            0.7 ms, against 10 ms for :meth:`plan`. One grasp in fifty that passes here has no plan (14 of 599 on tees,
            brackets and part_a).
        """
        return self._planner.reach(grasp, self._env.simulation.target)

    def plan(self, grasp: GraspCandidate) -> Plan | Abstention:
        """Plan the motion to a grasp, or return why there is none."""
        reached = self.reach(grasp)
        if isinstance(reached, Abstention):
            return reached
        approach = self._planner.approach(self._env.simulation.target, reached.q, grasp, self._pile_height())
        if approach is None:
            return Abstention.NO_CLEAR_APPROACH
        return Plan(grasp=grasp, q_grasp=reached.q, approach=approach, frame_id=self._env.frame_id)

    def observed_scene(self) -> ObservedScene:
        """Return the scene in the last frame; it is computed once a frame, when first asked for."""
        env, last = self._env, self._last_scene
        if last is None or last.frame is not env.frame or last.candidates is not env.candidates:
            last = self._last_scene = ObservedScene.from_frame(
                env.frame,
                env.candidates,
                env.workspace,
                self.grasp_set.surface,
                cell=self.settings.rank.cell,
                wall=env.config.bin.wall,
            )
        return last

    def _pile_height(self) -> HeightFunction:
        """Return the function from (P, 3) world points to the world height [m] of the observed surface under them."""
        heights = self.observed_scene().heights
        floor = float(self._env.workspace.T_world_bin[2, 3])

        def height(points_world: Floats) -> Floats:
            return heights.highest_at(transform_points(heights.T_bin_world, points_world)) + floor

        return height

    # --- attempt ---------------------------------------------------------------------------------------------------

    def execute(self, plan: Plan) -> PickResult:
        """Make the attempt and name its outcome; ``t_compute`` is the time spent on planning during the attempt.

        Raises:
            ValueError: Another frame has been taken since the plan was made.
        """
        env = self._env
        if plan.frame_id != env.frame_id:
            raise ValueError(f"the plan is for frame {plan.frame_id}, but the last one is {env.frame_id}: plan again")
        began, events_before, strays = env.simulation.time, len(env.events), env.unjudged()
        execution = self._execution(env, self.settings.execution)
        candidate = env.candidates[plan.grasp.candidate]
        settings = self.settings.doubles
        check = LoadCheck(env.simulation, self.gripper, plan.grasp.width, settings, self._wrist)
        may_put_back = settings.put_back and self._extra.allows(candidate.centre_world, len(env.candidates) - 1)
        self._ahead.watch(execution, check)
        planning = self._move(plan, execution, candidate.T_world_part, check, may_put_back)
        execution.await_judgement()
        self._ahead.renew(execution)
        # A part that was out of the bin already, and came to rest only now, belongs to an earlier attempt.
        kinds = [event.kind for event in env.events[events_before:] if event.part not in strays]
        outcome = execution.outcome(kinds)
        if outcome is not GraspOutcome.DELIVERED:
            self.failed.add(candidate.centre_world, plan.grasp.T_world_grasp)
        return PickResult(
            outcome=outcome,
            grasp=plan.grasp,
            part=candidate.part,
            delivered=kinds.count(Delivery.DELIVERED),
            t_sense=2 * T_SENSE if check.looked else T_SENSE,
            t_compute=planning,
            t_motion=env.simulation.time - began,
            frame_id=plan.frame_id,
            double_check=check.result,
        )

    def _plan_push(self) -> tuple[PoseCandidate, Push, Press] | None:
        """Return a part that may be moved once more with its push and the motion; None if there is none.

        Nothing has moved since the frame before, in which perception may have found other parts.
        """
        for scene in (self.observed_scene(), self._refused):
            if scene is None or not scene.candidates:
                continue
            pushes = find_pushes(scene, self.grasp_set, self.gripper, self.settings.push, self.settings.rank)
            allowed = [
                push
                for push in pushes
                if self._extra.allows(scene.candidates[push.candidate].centre_world, len(scene.candidates) - 1)
                and not any(push.resembles(other) for other in self._pushed)
            ]
            planned = self._pusher.plan(allowed, self._pile_height())
            if planned is not None:
                return scene.candidates[planned[0].candidate], *planned
        return None

    def _push(self, candidate: PoseCandidate, push: Push, press: Press) -> PickResult:
        """Make a push and name its outcome; ``t_compute`` is the time spent on planning during it."""
        env = self._env
        began, frame_id = env.simulation.time, env.frame_id
        execution = self._execution(env, self.settings.execution)
        outcome, planning = self._pusher.execute(push, press, execution, self._go_home)
        self._extra.moved(candidate.centre_world, candidate.centre_world + push.drag_world)
        self._pushed.append(push)
        if outcome is not PushOutcome.LEFT_BIN and isinstance(self._decide(), Plan):
            outcome = PushOutcome.FREED
        return PickResult(
            push=outcome,
            part=candidate.part,
            t_sense=T_SENSE,
            t_compute=planning,
            t_motion=env.simulation.time - began,
            frame_id=frame_id,
        )

    def _move(
        self, plan: Plan, execution: Execution, T_world_part: Floats, check: LoadCheck, may_put_back: bool
    ) -> float:
        """Run the attempt until the arm is home; return the wall clock spent on planning during it [s]."""
        grasp = plan.grasp
        if not execution.follow(plan.approach, self.gripper.control(grasp.opening), guard=True):
            return self._go_home(execution)
        execution.close()
        started = time.perf_counter()
        pile = self._pile_height()
        carry = self._planner.carry(plan.q_grasp, grasp, T_world_part, pile)
        planning = time.perf_counter() - started
        if carry is None:
            execution.release()
            execution.retrace()
            return planning
        # At home the next frame would be taken, in which the load is missing.
        check.image_possible = may_put_back and not np.allclose(carry.q[-1], HOME)
        if execution.carry(carry, self.gripper.control(self.settings.empty_gap), check, stop=may_put_back):
            planning += self._deliver(plan, execution, T_world_part, check)
        elif execution.double and execution.still_double(check):
            planning += self._put_back(plan, execution, T_world_part, check)
        elif check.result is not None:  # it is one part after all, or only an image can tell
            started = time.perf_counter()
            q_from = self._env.simulation.target.copy()
            carry = self._planner.carry(plan.q_grasp, grasp, T_world_part, pile, q_from)
            planning += time.perf_counter() - started
            if carry is None:
                execution.release()
                return planning + self._go_home(execution)
            check.image_possible = may_put_back and not np.allclose(carry.q[-1], HOME)
            if execution.carry(carry, self.gripper.control(self.settings.empty_gap)):
                planning += self._deliver(plan, execution, T_world_part, check)
        return planning + self._go_home(execution)

    def _deliver(self, plan: Plan, execution: Execution, T_world_part: Floats, check: LoadCheck) -> float:
        """Release the load over the tray, or put back what is more than one part; return the time of planning [s]."""
        double, planning = self._more_is_gone(T_world_part, check)
        if double:
            return planning + self._put_back(plan, execution, T_world_part, check)
        self._ahead.look(execution)
        execution.release()
        return planning + self._ahead.compare(execution)

    def _more_is_gone(self, T_world_part: Floats, check: LoadCheck) -> tuple[bool, float]:
        """Look over the tray, out of the camera's view, whether more than the part is gone from the bin, if need be.

        Returns:
            Whether more is gone, and the wall clock spent on it [s].
        """
        if not check.needs_image:
            return False, 0.0
        env = self._env
        image = image_of(env, self._rng)
        started = time.perf_counter()
        gone = gone_beside(self.observed_scene(), image, self.grasp_set.surface, T_world_part, env.config.bin.wall)
        double = check.see(None if gone is None else gone / mean_silhouette(env.part.model))
        return double, time.perf_counter() - started

    def _put_back(self, plan: Plan, execution: Execution, T_world_part: Floats, check: LoadCheck) -> float:
        """Put more than one part back where the pile is low; return the wall clock spent on planning [s].

        Where there is no way to such a place, they are let go where they are: above the bin, or over the tray.
        """
        started = time.perf_counter()
        pile, q_from = self._pile_height(), self._env.simulation.target.copy()
        centre, doubles = self._env.candidates[plan.grasp.candidate].centre_world, self.settings.doubles
        drop = doubles.second_drop if self._extra.times_put_back(centre) else doubles.drop
        low = low_places(self.observed_scene().heights, self._env.part.model.d_max / 2)
        places = DropPlaces(world=low, drop=drop)
        way = self._planner.put_back(q_from, plan.q_grasp, plan.grasp, T_world_part, pile, places)
        planning = time.perf_counter() - started
        if way is None:
            execution.put_down(None, check)
            return planning
        execution.follow(way.across, 1.0)
        execution.put_down(way.down, check)
        self._extra.put_back(centre, way.place_world)
        self.failed.add(way.place_world, plan.grasp.T_world_grasp, radius=self._env.part.model.d_max)
        return planning

    def _come_home(self) -> float:
        """Go home if a protective stop has kept the arm from it, for a frame taken there; return the time of it [s]."""
        began = self._env.simulation.time
        if self._env.episode.away:
            self._env.expect_frame()
            self._go_home(self._execution(self._env, self.settings.execution))
        return self._env.simulation.time - began

    def _go_home(self, execution: Execution) -> float:
        """Lift out of the bin and go home with the jaw open; return the wall clock spent on planning [s]."""
        if execution.place_home():
            return 0.0
        started = time.perf_counter()
        way = self._planner.home(self._env.simulation.target.copy())
        planning = time.perf_counter() - started
        if way is None:
            execution.retrace()
        else:
            execution.follow(way, 0.0)
        return planning
