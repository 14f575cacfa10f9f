"""The state of a cell, to go back to: the same actions then bring the same results, bit by bit."""

from copy import deepcopy
from dataclasses import dataclass
from typing import Any

from binpick_env.outcomes import DeliveryEvent, DeliveryJudge
from binpick_env.simulation_state import SimulationSnapshot

NOBODY = object()  # what the judge of a snapshot watches


@dataclass(frozen=True, eq=False, kw_only=True)
class Snapshot:
    """State of a `binpick_env.env.BinPickEnv` within an episode; nothing changes it.

    Attributes:
        simulation: Of the physics.
        judge: Of the deliveries, watching `NOBODY`.
        random: State of the generator behind sensor noise and perception.
        events: How parts left play so far.
        episode: The environment's other attributes, by name: the last frame, what was seen in it, counts.
    """

    simulation: SimulationSnapshot
    judge: DeliveryJudge
    random: dict[str, Any]
    events: tuple[DeliveryEvent, ...]
    episode: dict[str, Any]


def moved_judge(judge: DeliveryJudge, watched: object, instead: object) -> DeliveryJudge:
    """Return a copy of ``judge``, with all that it remembers, that watches ``instead`` of ``watched``."""
    return deepcopy(judge, {id(watched): instead})
