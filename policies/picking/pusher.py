"""The execution of a push: choose one that has a plan, press, drag while pressing, and go home."""

import time
from collections.abc import Callable, Iterator, Sequence
from itertools import chain, repeat

from binpick_env.cell.delivery import Delivery
from binpick_env.config import CONTROL_PERIOD
from binpick_env.env import BinPickEnv
from perception.geometry import Floats
from policies.grasping.gripper import GripperModel
from policies.grasping.outcomes import PushOutcome
from policies.grasping.pushes import CLOSED_GAP, Push
from policies.motion.path_checker import HeightFunction
from policies.motion.trajectory import Trajectory
from policies.picking.attempt_planner import AttemptPlanner, Press
from policies.picking.execution import Execution
from policies.picking.press_control import PressControl
from policies.picking.settings import PickerSettings


class Pusher:
    """Plans and executes pushes in one cell."""

    def __init__(
        self, env: BinPickEnv, planner: AttemptPlanner, gripper: GripperModel, settings: PickerSettings
    ) -> None:
        """Keep the cell and the planner of its motions."""
        self._env, self._planner, self._settings = env, planner, settings
        self._control = gripper.control(CLOSED_GAP)

    def plan(self, pushes: Sequence[Push], pile: HeightFunction) -> tuple[Push, Press] | None:
        """Return the first push to which there is a motion, with its motion; None if there is none."""
        target, settings = self._env.simulation.target, self._settings
        for push in pushes[: settings.grasps_tried]:
            press = self._planner.press(target, push.T_world_tips, pile)
            if press is None:
                continue
            if self._planner.drag(press.down.q[0], push.drag_world, settings.push.drag_speed) is not None:
                return push, press
        return None

    def execute(
        self, push: Push, press: Press, execution: Execution, go_home: Callable[[Execution], float]
    ) -> tuple[PushOutcome, float]:
        """Press, drag and go home.

        Returns:
            How it ended, which is never FREED, and the wall clock spent on planning [s].
        """
        env, settings = self._env, self._settings.push
        events_before, strays = len(env.events), env.unjudged()
        outcome, planning = PushOutcome.NOT_TOUCHED, 0.0
        if not execution.follow(press.approach, self._control, guard=True):
            outcome = PushOutcome.BROKEN_OFF
        elif execution.until_force(press.down.q[1:], self._control, settings.press_force):
            started = time.perf_counter()
            drag = self._planner.drag(env.simulation.target.copy(), push.drag_world, settings.drag_speed)
            planning = time.perf_counter() - started
            outcome = PushOutcome.BROKEN_OFF
            if drag is not None and not execution.until_force(self._pressing(drag), self._control, settings.stop_force):
                outcome = PushOutcome.MOVED
        planning += go_home(execution)
        execution.await_judgement()
        lost = [e for e in env.events[events_before:] if e.part not in strays and e.kind is not Delivery.DELIVERED]
        return (PushOutcome.LEFT_BIN if lost else outcome), planning

    def _pressing(self, way: Trajectory) -> Iterator[Floats]:
        """Yield the (6,) postures of a way, after a time of rest, each as much lower as the part must be pressed on."""
        control = PressControl(self._settings.push)
        rest = round(self._settings.push.press_time / CONTROL_PERIOD)
        q = self._env.simulation.target.copy()
        for planned in chain(repeat(way.q[0], rest), way.q[1:]):
            lower = control.felt(self._env.simulation.robot_contact().force)
            posture = self._planner.lowered(q, planned, lower)
            q = planned if posture is None else posture
            yield q
