"""Dropping parts into the bin until they have come to rest."""

import logging
import time

import numpy as np
from numpy.typing import NDArray

from binpick_env.cell.simulation import Simulation
from binpick_env.jobs.text_tables import counted
from binpick_env.part_limits import require_room
from perception.geometry import make_transform, random_rotation

log = logging.getLogger(__name__)
BATCH_PERIOD = 0.12  # time between two releases [s]
SETTLE_LIMIT = 6.0  # longest time that a pile gets to come to rest after the last release [s]
SINKING = 0.001  # depth of a centre under the floor [m] up to which it lies on it: soft contacts give way by 0.1 mm
ATTEMPTS = 5  # number of piles that are tried
PATIENCE = 15.0  # time after which the log says how far a pile is, and again after twice as long, and so on [s]


class SettleError(RuntimeError):
    """The pile did not come to rest inside the bin in any attempt."""


def drop_and_settle(simulation: Simulation, count: int, rng: np.random.Generator) -> None:
    """Fill the bin with parts, dropped in random attitudes, four at a time, and wait until all of them sleep.

    A part that comes to rest outside of the bin is dropped again. A pile that does not come to rest is started anew,
    and the log says so. It also says how far a pile is that takes long: many parts take minutes.

    Args:
        simulation: Simulation, which is reset first.
        count: Number of parts.
        rng: Source of all random numbers.

    Raises:
        ValueError: ``count`` is not in 0..capacity, or more than can be heaped on the bin.
        SettleError: No pile came to rest in ``ATTEMPTS`` attempts: the bin is too small for the parts. Or a part fell
            through the floor.
    """
    if not 0 <= count <= simulation.capacity:
        raise ValueError(f"count must be in 0..{simulation.capacity}, got {count}")
    require_room(simulation.part, simulation.config.bin, count)
    progress = _Progress(count)
    for attempt in range(ATTEMPTS):
        simulation.reset()
        waiting = list(range(count))
        for _ in range(3):
            _release(simulation, waiting, rng, progress)
            settled = _settle(simulation, progress)
            _require_above_floor(simulation)
            if not settled:
                break
            waiting = [i for i in range(count) if not inside_bin(simulation)[i]]
            if not waiting:
                return
        log.warning("pile %d of at most %d with %d parts did not come to rest in the bin", attempt + 1, ATTEMPTS, count)
    raise SettleError(
        f"{counted(count, 'part')} of d_max {simulation.part.model.d_max * 1000:.0f} mm do not come to rest in a bin "
        f"of {simulation.config.bin.inner_size} m; use fewer parts or a larger bin"
    )


class _Progress:
    """Says how far a pile is once it takes long."""

    def __init__(self, count: int) -> None:
        self._count, self._started, self._next = count, time.monotonic(), PATIENCE

    def tell(self, simulation: Simulation) -> None:
        """Log the numbers of parts that have been dropped and that lie still, if it is time."""
        passed = time.monotonic() - self._started
        if passed < self._next:
            return
        self._next *= 2
        dropped = int(np.count_nonzero(simulation.in_play))
        still = int(np.count_nonzero(simulation.in_play & simulation.asleep()))
        log.warning("%d of %d parts are dropped and %d lie still after %.0f s", dropped, self._count, still, passed)


def inside_bin(simulation: Simulation) -> NDArray[np.bool_]:
    """Return the (capacity,) mask of parts in play whose centre is within the bin's walls and below twice its rim."""
    workspace = simulation.config.bin.workspace()
    headroom = float(workspace.inner_size[2])
    return simulation.in_play & workspace.contains(simulation.part_centres(), headroom=headroom, floor=-SINKING)


def _require_above_floor(simulation: Simulation) -> None:
    """Refuse a pile of which a part lies under the bin's floor: dropping it again would hide that it fell through.

    Raises:
        SettleError: A centre is more than `SINKING` below the inner floor, and within its outline.
    """
    if not np.all(np.isfinite(simulation.data.qpos)):
        return  # diverged: nothing is known of where the parts are
    workspace = simulation.config.bin.workspace()
    centres_bin = workspace.to_bin(simulation.part_centres())
    under = np.all(np.abs(centres_bin[:, :2]) <= workspace.inner_size[:2] / 2, axis=1) & (centres_bin[:, 2] < -SINKING)
    fallen = int(np.count_nonzero(under & simulation.in_play))
    if fallen:
        raise SettleError(
            f"{counted(fallen, 'part')} fell through the floor of the bin: their contacts are not resolved at a time "
            f"step of {simulation.model.opt.timestep:g} s; use a shorter one, or a thicker part"
        )


def _release(simulation: Simulation, parts: list[int], rng: np.random.Generator, progress: _Progress) -> None:
    """Release parts in batches of up to four, one in each quadrant, just above the pile."""
    workspace = simulation.config.bin.workspace()
    reach = simulation.part.model.d_max / 2
    room = np.maximum(workspace.inner_size[:2] / 2 - 2 * reach, 0.0)
    spread = np.minimum(reach, workspace.inner_size[:2] / 2 - reach)
    for start in range(0, len(parts), 4):
        quadrants = rng.permutation(4)
        middle = rng.triangular(-1.0, 0.0, 1.0, size=2) * 0.4 * room  # mostly near the middle, as from a chute
        top = _top(simulation)
        for i, quadrant in zip(parts[start : start + 4], quadrants, strict=False):
            signs = np.array([1 if quadrant & 1 else -1, 1 if quadrant & 2 else -1])
            centre = np.array([*(middle + signs * spread), top + reach + 0.01])
            T_world_part = workspace.T_world_bin @ make_transform(random_rotation(rng), centre)
            simulation.place(i, T_world_part)
        simulation.advance(BATCH_PERIOD)
        progress.tell(simulation)


def _top(simulation: Simulation) -> float:
    """Return an upper bound of the pile's height above the bin's floor [m], at least the height of the rim."""
    workspace = simulation.config.bin.workspace()
    if not simulation.in_play.any():
        return float(workspace.inner_size[2])
    heights = workspace.to_bin(simulation.part_centres()[simulation.in_play])[:, 2]
    return float(max(heights.max() + simulation.part.model.d_max / 2, workspace.inner_size[2]))


def _settle(simulation: Simulation, progress: _Progress) -> bool:
    """Step until every part in play sleeps; return False after ``SETTLE_LIMIT``, or if the physics diverge."""
    for _ in range(round(SETTLE_LIMIT / 0.05)):
        simulation.advance(0.05)
        if not np.all(np.isfinite(simulation.data.qpos)):
            return False
        if simulation.asleep()[simulation.in_play].all():
            return True
        progress.tell(simulation)
    return False
