"""The state of a cell, to go back to: the same actions then bring the same results, bit by bit."""

from dataclasses import dataclass
from typing import Any

from binpick_env.cell.delivery import DeliveryEvent, JudgeState
from binpick_env.cell.simulation_state import SimulationSnapshot


@dataclass(frozen=True, eq=False, kw_only=True)
class Snapshot:
    """State of a `binpick_env.env.BinPickEnv` within an episode; nothing changes it.

    Attributes:
        simulation: Of the physics.
        judge: Of the judgement of deliveries.
        random: State of the generator behind sensor noise and perception.
        events: How parts left play so far.
        episode: The environment's other attributes, by name: the last frame, what was seen in it, counts.
    """

    simulation: SimulationSnapshot
    judge: JudgeState
    random: dict[str, Any]
    events: tuple[DeliveryEvent, ...]
    episode: dict[str, Any]
