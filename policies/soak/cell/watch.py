"""The rules that every step of the cell must keep, whatever the actions are."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from binpick_env.cell.simulation import Simulation
from binpick_env.config import CONTROL_PERIOD
from perception.geometry import Floats
from policies.soak.cell.depth import DepthGauge
from policies.soak.cell.energy import DrivenParts, EnergyMeter, set_control_callback

_FALL = 9.81 * CONTROL_PERIOD  # speed that a fall adds within a step [m/s]
_HEAVY = 0.05  # mass under which a part is pushed in deeper, in inverse proportion: contacts yield so [kg]
_LIGHTEST = 2.2  # largest factor for that: 4.4 mm is under the middle of every wall
REST = 5  # steps after the robot's last push from which a part counts as left alone; a contact gives way that long


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a step may do at most."""

    depth: float = 0.002  # depth inside a wall or a floor of a part that the robot leaves alone [m]
    gain: float = 1.0  # energy that a part gains in a step without the robot, besides its fall [J]


class CellWatch:
    """Judges the steps of one simulation and remembers what it saw.

    Contacts are soft. A part that falls sinks in for a moment, which the limit of depth allows for. So does a part that
    the arm hits at full speed, as far as 9 mm where it is light, until the protective stop has ended the push. It must
    come back within `REST` steps, to a deeper limit if it weighs under 50 g, and must not pass the middle of the wall.

    Attributes:
        steps: Number of steps.
        deepest: Largest depth inside a wall or a floor of a part that the robot leaves alone [m].
        pressed: Largest depth of any part, the robot's push included [m].
        gain: Largest energy, kinetic and potential, that a part gained in a step without the robot [J].
        problems: One sentence for each rule that was broken; of one rule, the first of each episode.
    """

    def __init__(self, simulation: Simulation, limits: Limits | None = None) -> None:
        """Judge nothing yet."""
        self._simulation = simulation
        self._limits = limits or Limits()
        self._gauge = DepthGauge(simulation)
        self._driven = DrivenParts(simulation)
        self._meter = EnergyMeter(simulation)
        self._speeds = np.zeros(simulation.capacity)  # before the step [m/s]
        self._softness = 0.35 * simulation.config.contact.solref[0]
        self._since = np.full(simulation.capacity, REST)  # steps since the robot drove each part
        self._deep_for = np.zeros(simulation.capacity, np.int64)  # steps for which each part was pushed in too deep
        self._lightness = lightness(simulation.part.mass)
        self._broken: set[str] = set()
        self._episode = "before the first reset"
        self.steps = 0
        self.deepest = self.pressed = self.gain = 0.0
        self.problems: list[str] = []

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Judge each step of the simulation within this context."""
        simulation: Any = self._simulation
        step = simulation.step

        def watched(joint_targets: Floats, gripper: float) -> None:
            before, in_play = self._meter.energies(), simulation.in_play.copy()
            self._speeds = simulation.part_speeds()
            self._driven.clear()
            self._driven.collect()
            set_control_callback(self._driven.collect)
            try:
                step(joint_targets, gripper)
            finally:
                set_control_callback(None)
            self._driven.collect()
            self._judge(self._meter.energies() - before, in_play)

        simulation.step = watched
        try:
            yield
        finally:
            del simulation.step

    def begin(self, episode: str) -> None:
        """Start an episode: the pile is judged, and each rule may be broken once more."""
        self._episode = episode
        self._broken.clear()
        self._since[:] = REST
        self._deep_for[:] = 0
        self._speeds[:] = 0.0
        self._judge_depth("at rest")

    def largest(self) -> dict[str, float]:
        """Return the largest values that were seen, with names for a table."""
        return {
            "depth in walls and floors, left alone [mm]": 1000 * self.deepest,
            "depth in walls and floors, pushed [mm]": 1000 * self.pressed,
            "energy gained, left alone [J]": self.gain,
        }

    def judge_observation(self, observation: Mapping[str, Any], space: spaces.Space[Any]) -> None:
        """Judge an observation: it must be within its space and have no NaN."""
        for name, value in observation.items():
            if not np.all(np.isfinite(value)):
                self._report("finite", f"{name} of the observation is not finite")
        if not space.contains(observation):
            self._report("space", "the observation is outside its space")

    def _judge(self, gains: Floats, in_play: NDArray[np.bool_]) -> None:
        self.steps += 1
        simulation = self._simulation
        # The wake of a contact: a part that the robot hit at the end of a step flies off in the next.
        self._since = np.where(self._driven.mask(), 0, self._since + 1)
        free = in_play & simulation.in_play & (self._since > 1)
        if free.any():
            gain = float(gains[free].max())
            self.gain = max(self.gain, gain)
            if gain > self._limits.gain:
                self._report("energy", f"a part that the robot does not touch gains {gain:.2f} J in a step")
        if not np.all(np.isfinite(simulation.data.qpos)):
            self._report("finite", "the state is not finite")
        self._judge_depth("moving")

    def _judge_depth(self, when: str) -> None:
        depths, boxes = self._gauge.depths()
        alone = np.where(self._since >= REST, depths, 0.0)
        self.deepest, self.pressed = max(self.deepest, float(alone.max())), max(self.pressed, float(depths.max()))
        # A part that falls sinks in by about 0.35 of its speed times the contact's time constant, and comes back.
        speeds = np.maximum(self._speeds, self._simulation.part_speeds())
        speeds = speeds + np.minimum(speeds, _FALL)  # what it gains before it lands within the step
        limits = self._limits.depth + self._softness * speeds
        k = int(np.argmax(alone - limits))
        if alone[k] > limits[k]:
            text = f"{1000 * alone[k]:.1f} mm inside {self._gauge.names[boxes[k]]}, {when} at {speeds[k]:.2f} m/s"
            self._report("depth", f"a part that the robot leaves alone is {text}")
        too_deep = depths - limits > self._limits.depth * (self._lightness - 1)
        self._deep_for = np.where((self._since < REST) & too_deep, self._deep_for + 1, 0)
        p = int(np.argmax(self._deep_for))
        if self._deep_for[p] >= REST:
            text = f"{1000 * depths[p]:.1f} mm inside {self._gauge.names[boxes[p]]} for {REST} steps"
            self._report("pressed", f"a part that the robot pushes is {text}")
        i = int(np.argmax(depths / self._gauge.middles[boxes]))
        if depths[i] >= 0.99 * self._gauge.middles[boxes[i]]:
            self._report("middle", f"a part is pushed to the middle of {self._gauge.names[boxes[i]]}")

    def _report(self, rule: str, text: str) -> None:
        if rule not in self._broken:
            self._broken.add(rule)
            self.problems.append(f"{self._episode}, t = {self._simulation.time:.2f} s: {text}")


def lightness(mass: float) -> float:
    """Return how much deeper a part of ``mass`` [kg] may be pushed in than a heavy one."""
    return float(np.clip(_HEAVY / mass, 1.0, _LIGHTEST))
