"""How often parts may be put back or pushed in a bin."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from perception.geometry import Floats

PER_PART = 2  # largest number of extra decisions for a part
SHARE = 0.2  # largest share of a bin's decisions that may be extra ones


class _Move(NamedTuple):
    """A decision that moved a part without delivering it."""

    start: Floats  # (3,) place of the part before [m]
    end: Floats  # (3,) place that it was moved to [m]
    times: int  # number of such decisions on this part so far

    def distance(self, place: Floats) -> float:
        """Return the distance of a (3,) place from the way between start and end [m]."""
        way = self.end - self.start
        length = float(way @ way)
        share = float(np.clip((place - self.start) @ way / length, 0.0, 1.0)) if length > 0 else 0.0
        return float(np.linalg.norm(self.start + share * way - place))


@dataclass(eq=False, kw_only=True)
class ExtraDecisions:
    """Counts the decisions of one bin, and among them those that move a part without delivering it.

    Parts are not tracked from frame to frame: places identify them. The count of a part goes on where it was moved to,
    and where it was, and between, since it may not have followed.

    Attributes:
        radius: Distance between two places under which they belong to the same part [m].
        decisions: Number of decisions made.
        extra: Number of decisions among them that moved a part without delivering it.
    """

    radius: float
    decisions: int = 0
    extra: int = 0
    _moved: list[_Move] = field(default_factory=list)
    _put_back: list[_Move] = field(default_factory=list)

    def decided(self) -> None:
        """Count a decision."""
        self.decisions += 1

    def allows(self, centre_world: Floats, expected: int = 0) -> bool:
        """Tell whether the part at a (3,) place may be moved once more, by the next decision.

        Args:
            centre_world: Place of the part [m].
            expected: Number of decisions that are still to come in any case, beside the next one.
        """
        share = (self.extra + 1) <= SHARE * (self.decisions + 1 + expected) + 1e-9
        return share and self._times(centre_world) < PER_PART

    def moved(self, centre_world: Floats, to_world: Floats) -> None:
        """Note that the last decision moved the part at a (3,) place to another one [m]."""
        self.extra += 1
        self._moved.append(_Move(np.asarray(centre_world), np.asarray(to_world), self._times(centre_world) + 1))

    def put_back(self, centre_world: Floats, to_world: Floats) -> None:
        """Note that the last decision put parts from a (3,) place back to another one [m]."""
        place = np.asarray(to_world)  # the jaw held them on the way
        self.extra += 1
        self._put_back.append(_Move(place, place, self.times_put_back(centre_world) + 1))
        self._moved.append(_Move(place, place, self._times(centre_world) + 1))

    def times_put_back(self, centre_world: Floats) -> int:
        """Return how often the part at a (3,) place was put back together with another one [m]."""
        return self._most(self._put_back, centre_world)

    def _times(self, centre_world: Floats) -> int:
        return self._most(self._moved, centre_world)

    def _most(self, moves: list[_Move], centre_world: Floats) -> int:
        return max((move.times for move in moves if move.distance(centre_world) < self.radius), default=0)
