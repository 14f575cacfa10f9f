"""Actions that no picker would give: random ones, and hostile ones such as a press on a corner of the bin."""

from collections.abc import Callable, Iterator, Sequence
from itertools import chain, cycle, islice

import numpy as np
from numpy.typing import NDArray

from binpick_env.cell.robot import HOME
from binpick_env.env import BinPickEnv
from perception.geometry import Floats, make_transform
from policies.motion.ik import IkSolver
from policies.motion.planning_scene import PlanningScene

LENGTHS = (10, 60)  # smallest and largest number of steps that one kind of action lasts
_DOWN = np.diag([1.0, -1.0, -1.0])  # rotation of a tcp whose approach points down
_Targets = Iterator[Floats]


class HostileActions:
    """Draws sequences of (7,) actions for one cell: six joint targets [rad], and the gripper from 0 to 1."""

    def __init__(self, env: BinPickEnv) -> None:
        """Find postures over the corners of the bin, above the rim and pressed on the floor."""
        self._env = env
        space = env.action_space
        self._low, self._high = np.asarray(space.low), np.asarray(space.high)  # type: ignore[attr-defined]
        self._ik = IkSolver(PlanningScene(env.config))
        workspace = env.workspace
        length, width, height = workspace.inner_size
        corners = [(x, y) for x in (-length / 2, length / 2) for y in (-width / 2, width / 2)]
        self._above = [self._posture(workspace.T_world_bin, x, y, height + 0.1) for x, y in [(0.0, 0.0), *corners]]
        self._pressed = [self._posture(workspace.T_world_bin, 0.9 * x, 0.9 * y, -0.01) for x, y in corners]

    def draw(self, rng: np.random.Generator) -> Iterator[NDArray[np.float32]]:
        """Yield actions without end, one kind of them after the other."""
        kinds: Sequence[Callable[[np.random.Generator], _Targets]] = (
            self._uniform,
            self._bounds,
            self._alternating,
            self._jitter,
            self._corner,
            self._sweep,
            self._toggle,
            self._grab,
        )
        while True:
            kind = kinds[int(rng.integers(len(kinds)))]
            for action in islice(kind(rng), int(rng.integers(*LENGTHS))):
                yield np.clip(action, self._low, self._high).astype(np.float32)

    # --- kinds -----------------------------------------------------------------------------------------------------

    def _uniform(self, rng: np.random.Generator) -> _Targets:
        """Anything in the space, another in every step."""
        while True:
            yield rng.uniform(self._low, self._high)

    def _bounds(self, rng: np.random.Generator) -> _Targets:
        """Corners of the space, each held for some steps."""
        while True:
            corner = np.where(rng.random(7) < 0.5, self._low, self._high)
            yield from [corner] * int(rng.integers(1, 20))

    def _alternating(self, rng: np.random.Generator) -> _Targets:
        """The same swing with alternating signs."""
        q, swing = self._env.simulation.joint_positions, rng.uniform(0.02, 0.5, 6)
        for sign in cycle((1.0, -1.0)):
            yield np.append(q + sign * swing, (sign + 1) / 2)

    def _jitter(self, rng: np.random.Generator) -> _Targets:
        """Small steps from wherever the arm is."""
        while True:
            yield np.append(self._env.simulation.joint_positions + rng.normal(scale=0.1, size=6), rng.random())

    def _corner(self, rng: np.random.Generator) -> _Targets:
        """A press on one corner of the bin, again and again."""
        k = int(rng.integers(len(self._pressed)))
        legs = [self._above[k + 1]] * 8 + [self._pressed[k]] * 8
        return self._with_gripper(cycle(legs), float(rng.integers(2)))

    def _sweep(self, rng: np.random.Generator) -> _Targets:
        """Along the floor from corner to corner, through the parts."""
        order = rng.permutation(len(self._pressed))
        legs = [self._above[0]] * 10 + list(chain.from_iterable([self._pressed[k]] * 6 for k in order))
        return self._with_gripper(cycle(legs), float(rng.integers(2)))

    def _toggle(self, rng: np.random.Generator) -> _Targets:
        """A jaw that opens and closes in every step, in a corner of the bin."""
        target = self._pressed[int(rng.integers(len(self._pressed)))]
        for gripper in cycle((0.0, 1.0)):
            yield np.append(target, gripper)

    def _grab(self, rng: np.random.Generator) -> _Targets:
        """A grasp at the highest part, lifted and let go."""
        simulation = self._env.simulation
        centres = simulation.part_centres()[simulation.in_play]
        if not len(centres):
            return self._uniform(rng)
        x, y, z = centres[np.argmax(centres[:, 2])]
        over, at = (self._solved(x, y, z + lift) for lift in (0.12, -0.01))
        open_legs, closed_legs = [over] * 15 + [at] * 10, [at] * 12 + [over] * 10
        once = [*(np.append(q, 0.0) for q in open_legs), *(np.append(q, 1.0) for q in closed_legs)]
        return chain(once, cycle([np.append(over, 0.0)]))

    # --- inside ----------------------------------------------------------------------------------------------------

    def _posture(self, T_world_bin: Floats, x: float, y: float, z: float) -> Floats:
        return self._solved(*(T_world_bin @ np.array([x, y, z, 1.0]))[:3])

    def _solved(self, x: float, y: float, z: float) -> Floats:
        """Return the (6,) posture nearest to a tcp that points down at a place in the world; contacts are welcome."""
        return self._ik.solve(make_transform(_DOWN, (x, y, z)), HOME).q

    def _with_gripper(self, postures: Iterator[Floats], gripper: float) -> _Targets:
        return (np.append(q, gripper) for q in postures)
