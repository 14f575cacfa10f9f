"""The soak test of ``BinPick-v0``: hostile actions on ten parts, and the growth of memory over resets."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from binpick_env.env import BinPickEnv
from policies.soak.cell.actions import HostileActions
from policies.soak.cell.memory import MemorySettings, growth_in_child
from policies.soak.cell.parts import PARTS, unit_name
from policies.soak.cell.watch import CellWatch
from policies.soak.choices import SoakKind
from policies.soak.unit import UnitResult

EPISODE = 250  # steps after which a new pile is dropped
LEARNED = 0.25  # share of the units whose frames are perceived from pixels; true poses in the others
GROWTH = 1.0  # most memory that 100 resets may add [MB]
JUDGED = 100  # number of resets from which the growth is judged: caches and pools fill before
_MEMORY = "memory"


@dataclass(frozen=True, kw_only=True)
class EnvSoak:
    """Steps of the cell in units of one part each.

    Attributes:
        steps: Number of steps, rounded up to whole units.
        seed: Seed; unit k is drawn from (seed, k).
        chunk: Number of steps of a unit.
        parts: Names of the parts, taken in turn.
        num_parts: Smallest and largest number of parts in a pile.
        memory: How the growth of memory is measured; None leaves it out.
    """

    kind: ClassVar[SoakKind] = "env"
    steps: int = 100_000
    seed: int = 0
    chunk: int = 500
    parts: tuple[str, ...] = PARTS
    num_parts: tuple[int, int] = (1, 15)
    memory: MemorySettings | None = None

    def __post_init__(self) -> None:
        if self.steps < 1 or self.chunk < 1:
            raise ValueError(f"steps and chunk must be at least 1, got {self.steps} and {self.chunk}")

    def settings(self) -> dict[str, Any]:
        """Return what the result of a unit depends on; the number of steps is no part of it."""
        facts = asdict(self)
        del facts["steps"], facts["memory"]
        return facts

    def units(self) -> Sequence[str]:
        """Return the names of the units: the number and the part of each, and that of the memory."""
        count = -(-self.steps // self.chunk)
        names = [unit_name(self.parts[k % len(self.parts)], k) for k in range(count)]
        return names if self.memory is None else [*names, f"{_MEMORY}-{self.memory.resets}"]

    def run(self, unit: str, folder: Path) -> UnitResult:  # noqa: ARG002 - the form of a soak test
        """Make the steps of a unit, or measure the memory."""
        if self.memory is not None and unit.startswith(_MEMORY):
            growth = growth_in_child(self.memory)
            too_much = (f"{growth:.2f} MB more for each 100 resets, {GROWTH:g} MB is the limit",)
            problems = too_much if growth > GROWTH and self.memory.resets >= JUDGED else ()
            largest = {"growth [MB in 100 resets]": growth}
            return UnitResult(
                name=unit, counts={"resets of one cell": self.memory.resets}, largest=largest, problems=problems
            )
        return self._steps(unit, int(unit[:5]))

    def close(self) -> None:
        """Nothing is open between units."""

    def _steps(self, unit: str, number: int) -> UnitResult:
        rng = np.random.default_rng([self.seed, number])
        perception = "learned" if rng.random() < LEARNED else "oracle"
        part = self.parts[number % len(self.parts)]
        env = BinPickEnv(part=part, num_parts=self.num_parts, perception=perception, threads=1)
        watch = CellWatch(env.simulation)
        resets = 0
        try:
            with watch.watching():
                actions = HostileActions(env).draw(rng)
                over = True
                for k in range(self.chunk):
                    if over or k % EPISODE == 0:
                        seed = int(rng.integers(2**31))
                        observation, _ = env.reset(seed=seed)
                        watch.begin(f"{perception}, reset with seed {seed}, step {k}")
                        watch.judge_observation(observation, env.observation_space)
                        resets += 1
                    observation, _, over, _, _ = env.step(next(actions))
                    watch.judge_observation(observation, env.observation_space)
        except Exception as error:  # whatever it is, it is what the soak test looks for
            watch.problems.append(f"{type(error).__name__}: {error}")
        finally:
            env.close()
        return UnitResult(
            name=unit,
            counts={"steps": watch.steps, "resets": resets},
            largest=watch.largest(),
            problems=tuple(watch.problems),
        )
