"""The judgement of deliveries: which parts were delivered alone, delivered together, or lost outside bin and tray."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from binpick_env.cell.simulation import Simulation
from perception.frame import Workspace
from perception.geometry import Floats, make_transform

OPEN_BELOW = 0.35  # gripper command below which the jaw counts as open
REST_SPEED = 0.02  # speed below which a part counts as at rest [m/s]
REST_TIME = 0.12  # time at rest after which a release is judged [s]
LOST_AFTER = 1.0  # time at rest or falling outside of bin and tray after which a part is lost [s]


class Delivery(StrEnum):
    """How a part left play."""

    DELIVERED = "delivered"  # released over the tray, at rest in it, alone
    DOUBLE = "double"  # at rest in the tray together with others of the same release
    UNRELEASED = "unreleased"  # fell into the tray before the gripper had opened
    LEFT_BIN = "left_bin"  # came to lie outside of bin and tray


@dataclass(frozen=True, kw_only=True)
class DeliveryEvent:
    """A part that leaves play.

    Attributes:
        part: Index of the part.
        kind: How it left play.
        time: Simulated time of the judgement [s].
    """

    part: int
    kind: Delivery
    time: float


@dataclass(frozen=True, eq=False, kw_only=True)
class JudgeState:
    """State of a `DeliveryJudge`.

    Attributes:
        entered: Parts that came over the tray since the gripper last opened.
        unreleased: Parts that fell into the tray while the gripper was closed.
        still: (capacity,) time for which each part has been at rest [s].
        outside: (capacity,) time for which each part has been at rest or falling outside of bin and tray [s].
        was_open: Whether the jaw counted as open at the last update.
    """

    entered: frozenset[int]
    unreleased: frozenset[int]
    still: Floats
    outside: Floats
    was_open: bool


class DeliveryJudge:
    """Decides when and how parts leave play, and parks them.

    It remembers which parts entered the tray since the gripper last opened, and how long each has been at rest.
    """

    def __init__(self, simulation: Simulation, period: float) -> None:
        """Judge the parts of a simulation, with an update every ``period`` [s]."""
        self._simulation = simulation
        self._period = period
        tray = simulation.config.tray
        T_world_tray = make_transform(translation=(*tray.position, tray.wall))
        self._tray = Workspace(T_world_bin=T_world_tray, inner_size=np.array(tray.inner_size))
        self._bin = simulation.config.bin.workspace()
        count = simulation.capacity
        self._entered: set[int] = set()
        self._unreleased: set[int] = set()
        self._still = np.zeros(count)
        self._outside = np.zeros(count)
        self._was_open = True

    def state(self) -> JudgeState:
        """Return the state for :meth:`restore`."""
        return JudgeState(
            entered=frozenset(self._entered),
            unreleased=frozenset(self._unreleased),
            still=self._still.copy(),
            outside=self._outside.copy(),
            was_open=self._was_open,
        )

    def restore(self, state: JudgeState) -> None:
        """Go back to a state."""
        self._entered, self._unreleased = set(state.entered), set(state.unreleased)
        self._still, self._outside = state.still.copy(), state.outside.copy()
        self._was_open = state.was_open

    def inside_tray(self) -> NDArray[np.bool_]:
        """Return the (capacity,) mask of parts in play whose centre is in the tray, up to its rim."""
        return self._simulation.in_play & self._tray.contains(self._simulation.part_centres())

    def loose(self) -> NDArray[np.bool_]:
        """Return the (capacity,) mask of parts in play that are neither in the bin nor touched by the gripper."""
        simulation = self._simulation
        in_bin = self._bin.contains(simulation.part_centres(), headroom=float(self._bin.inner_size[2]))
        return simulation.in_play & ~in_bin & ~simulation.touched_by_robot()

    def update(self, gripper: float) -> list[DeliveryEvent]:
        """Judge after one control period, and return how parts left play in it.

        Args:
            gripper: Gripper command of the period, 0 open to 1 closed.
        """
        simulation = self._simulation
        is_open = gripper < max(OPEN_BELOW, simulation.gripper_open + 1e-3)  # a narrow jaw's widest counts as open
        if is_open and not self._was_open:
            self._entered.clear()
        self._was_open = is_open
        if not simulation.in_play.any():
            return []
        speeds = simulation.part_speeds()
        held = simulation.touched_by_robot()
        self._still = np.where((speeds < REST_SPEED) & ~held, self._still + self._period, 0.0)
        in_tray = self.inside_tray()
        for i in np.flatnonzero(in_tray):
            if i not in self._entered and not is_open and not held[i]:
                self._unreleased.add(int(i))
        if is_open:
            # Up to twice the rim's height: a part that comes to lie on another one has entered together with it.
            over_tray = self._tray.contains(simulation.part_centres(), headroom=float(self._tray.inner_size[2]))
            self._entered.update(int(i) for i in np.flatnonzero(simulation.in_play & over_tray))
        return [*self._judge_tray(in_tray), *self._judge_lost(in_tray)]

    def _judge_tray(self, in_tray: NDArray[np.bool_]) -> list[DeliveryEvent]:
        """Judge a release once all of its parts are at rest in the tray or have left it again."""
        present = {int(i) for i in np.flatnonzero(in_tray)}
        if not present or any(self._still[i] < REST_TIME for i in present):
            return []
        events = []
        for i in sorted(present):
            if i in self._unreleased:
                kind = Delivery.UNRELEASED
            elif self._entered == present == {i}:
                kind = Delivery.DELIVERED
            else:
                kind = Delivery.DOUBLE
            events.append(self._retire(i, kind))
        return events

    def _judge_lost(self, in_tray: NDArray[np.bool_]) -> list[DeliveryEvent]:
        """Judge the parts that have been at rest or falling outside of bin and tray for long enough."""
        z = self._simulation.part_centres()[:, 2]
        stray = self.loose() & ~in_tray & ((self._still > 0) | (z < 0.0))
        self._outside = np.where(stray, self._outside + self._period, 0.0)
        return [self._retire(int(i), Delivery.LEFT_BIN) for i in np.flatnonzero(self._outside >= LOST_AFTER)]

    def _retire(self, i: int, kind: Delivery) -> DeliveryEvent:
        """Take part ``i`` out of play."""
        self._simulation.park(i)
        self._unreleased.discard(i)
        self._still[i] = self._outside[i] = 0.0
        return DeliveryEvent(part=i, kind=kind, time=self._simulation.time)
