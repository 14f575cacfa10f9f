"""One bin from the drop to its end: when to take another frame, and when to stop."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from binpick_env.cell.delivery import Delivery
from binpick_env.env import BinPickEnv
from binpick_env.scenes.clutter import ClutterStats
from policies.grasping.outcomes import GraspOutcome, PickResult


class Termination(StrEnum):
    """Why a bin ended."""

    EMPTY = "empty"  # no part is left in play
    TWO_FAILURES = "2F"  # two consecutive failed attempts (VGN's rule), or as many as the bin was allowed
    # no attempt was made, twice in a row, the second time on a new frame of which likely poses are candidates, too
    ABSTAINED = "abstained"
    TIME = "time"  # the environment truncated the episode


class Picker(Protocol):
    """Decides and executes one pick at a time."""

    def reset(self) -> None:
        """Forget the last bin; called after the environment's reset."""
        ...

    def pick(self) -> PickResult:
        """Make one decision on the last frame: an executed attempt, or an abstention."""
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class BinResult:
    """The picks of one bin.

    Attributes:
        seed: Seed of the environment's reset.
        parts_total: Number of parts after settling.
        delivered: Number of parts delivered.
        picks: Every decision in order, attempts and abstentions.
        termination: Why the bin ended.
        clutter: Visible fractions of the settled parts.
        lost: Number of parts that left play without being delivered: doubles, and parts that fell out of the bin or,
            before the release, into the tray.
    """

    seed: int
    parts_total: int
    delivered: int
    picks: tuple[PickResult, ...]
    termination: Termination
    clutter: ClutterStats
    lost: int = 0

    @property
    def attempts(self) -> tuple[PickResult, ...]:
        """The executed attempts."""
        return tuple(pick for pick in self.picks if pick.outcome is not None)


def run_bin(
    env: BinPickEnv,
    picker: Picker,
    seed: int,
    on_pick: Callable[[PickResult], None] | None = None,
    *,
    max_failures: int | None = 2,
) -> BinResult:
    """Pick one bin: two consecutive failures end it, and so does a second consecutive abstention.

    Args:
        env: The unwrapped environment, which is reset.
        picker: Picker that acts on the same environment.
        seed: Seed of the pile, the sensor noise and everything else that is random.
        on_pick: Callback after each decision, for progress and pictures.
        max_failures: Number of consecutive failures that ends the bin; None for no limit.
    """
    env.reset(seed=seed)
    picker.reset()
    clutter = ClutterStats.from_fractions(env.labelled_capture.visible_fractions[env.simulation.in_play])
    picks: list[PickResult] = []
    while (termination := _ended(env, picks, max_failures)) is None:
        result = picker.pick()
        picks.append(result)
        if on_pick is not None:
            on_pick(result)
        if result.abstention is not None and _ended(env, picks, max_failures) is None:
            env.look(likely=True)
    return BinResult(
        seed=seed,
        parts_total=env.total,
        delivered=env.delivered,
        picks=tuple(picks),
        termination=termination,
        clutter=clutter,
        lost=sum(event.kind is not Delivery.DELIVERED for event in env.events),
    )


def _ended(env: BinPickEnv, picks: list[PickResult], max_failures: int | None) -> Termination | None:
    if env.remaining == 0:
        return Termination.EMPTY
    if env.truncated:
        return Termination.TIME
    last = picks[-2:]
    if len(last) == 2 and all(pick.abstention is not None for pick in last):
        return Termination.ABSTAINED
    attempts = [pick for pick in picks if pick.outcome not in (None, GraspOutcome.PUT_BACK)]
    failing = max_failures is not None and len(attempts) >= max_failures
    if failing and not any(pick.success for pick in attempts[-max_failures:]):  # type: ignore[operator]
        return Termination.TWO_FAILURES
    return None
