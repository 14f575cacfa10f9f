"""The soak test of ``BinPickSelect-v0``: random decisions on ten parts."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from policies.selection.env import GraspSelectionEnv
from policies.soak.cell.parts import PARTS, unit_name
from policies.soak.cell.watch import CellWatch
from policies.soak.choices import SoakKind
from policies.soak.unit import UnitResult

EMPTY = 0.1  # share of the decisions that ignore the mask
FAST = 0.25  # share of the units in the fast training mode


@dataclass(frozen=True, kw_only=True)
class SelectSoak:
    """Decisions in units of one part each.

    Attributes:
        decisions: Number of decisions, rounded up to whole units.
        seed: Seed; unit k is drawn from (seed, k).
        chunk: Number of decisions of a unit.
        parts: Names of the parts, taken in turn.
        num_parts: Smallest and largest number of parts in a pile.
    """

    kind: ClassVar[SoakKind] = "select"
    decisions: int = 10_000
    seed: int = 0
    chunk: int = 20
    parts: tuple[str, ...] = PARTS
    num_parts: tuple[int, int] = (2, 15)

    def __post_init__(self) -> None:
        if self.decisions < 1 or self.chunk < 1:
            raise ValueError(f"decisions and chunk must be at least 1, got {self.decisions} and {self.chunk}")

    def settings(self) -> dict[str, Any]:
        """Return what the result of a unit depends on; the number of decisions is no part of it."""
        facts = asdict(self)
        del facts["decisions"]
        return facts

    def units(self) -> Sequence[str]:
        """Return the names of the units: the number and the part of each."""
        count = -(-self.decisions // self.chunk)
        return [unit_name(self.parts[k % len(self.parts)], k) for k in range(count)]

    def run(self, unit: str, folder: Path) -> UnitResult:  # noqa: ARG002 - the form of a soak test
        """Make the decisions of a unit."""
        number = int(unit[:5])
        rng = np.random.default_rng([self.seed, number])
        fast = bool(rng.random() < FAST)
        part = self.parts[number % len(self.parts)]
        env = GraspSelectionEnv(part=part, num_parts=self.num_parts, perception="oracle", threads=1, fast=fast)
        watch = CellWatch(env.cell.simulation)
        decisions = resets = 0
        try:
            with watch.watching():
                over = True
                for k in range(self.chunk):
                    if over:
                        seed = int(rng.integers(2**31))
                        observation, _ = env.reset(seed=seed)
                        watch.begin(f"{'fast' if fast else 'full'}, reset with seed {seed}, decision {k}")
                        watch.judge_observation(observation, env.observation_space)
                        resets += 1
                    observation, _, ended, cut, _ = env.step(random_row(env, rng))
                    watch.judge_observation(observation, env.observation_space)
                    over = ended or cut
                    decisions += 1
        except Exception as error:  # whatever it is, it is what the soak test looks for
            watch.problems.append(f"{type(error).__name__}: {error}")
        finally:
            env.close()
        return UnitResult(
            name=unit,
            counts={"decisions": decisions, "resets": resets, "steps": watch.steps},
            largest=watch.largest(),
            problems=tuple(watch.problems),
        )

    def close(self) -> None:
        """Nothing is open between units."""


def random_row(env: GraspSelectionEnv, rng: np.random.Generator) -> np.int64:
    """Return a random row with a candidate, and now and then any row."""
    rows = np.flatnonzero(env.action_masks())
    if not len(rows) or rng.random() < EMPTY:
        return np.int64(rng.integers(env.action_space.n))  # type: ignore[attr-defined]
    return np.int64(rng.choice(rows))
