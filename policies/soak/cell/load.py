"""The soak test of load: many environments in one process, and shared pipelines, against the same alone."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from binpick_env.jobs.process_map import WorkerError, map_indices
from policies.soak.cell.crowd import Member, pick_alone, pick_together
from policies.soak.cell.parts import PARTS
from policies.soak.cell.shared_pipelines import differences
from policies.soak.choices import SoakKind
from policies.soak.unit import UnitResult

FAST = 0.5  # share of the environments in the fast training mode
GROWTH = 100.0  # most memory that the environments of a unit may add in the second half of their time [MB]
_TOGETHER, _ALONE, _PIPELINES = range(3)


@dataclass(frozen=True, kw_only=True)
class LoadSoak:
    """Simulated time of environments that pick side by side.

    Attributes:
        seconds: Simulated time of all environments together [s], rounded up to whole units.
        seed: Seed; unit k is drawn from (seed, k).
        environments: Number of environments in one process.
        learned: Number of them that perceive pixels; each has a pipeline of its own, of another part.
        alone: Number of them that are run again, alone; another choice in each unit.
        threads: Number of threads that the environments take turns on, and that share a pipeline.
        chunk: Simulated time of each environment in a unit [s].
        parts: Names of the parts, taken in turn.
        num_parts: Smallest and largest number of parts in a pile.
    """

    kind: ClassVar[SoakKind] = "load"
    seconds: int = 86_400
    seed: int = 0
    environments: int = 16
    learned: int = 2
    alone: int = 4
    threads: int = 8
    chunk: int = 120
    parts: tuple[str, ...] = PARTS
    num_parts: tuple[int, int] = (2, 12)

    def __post_init__(self) -> None:
        if self.seconds < 1 or self.chunk < 1:
            raise ValueError(f"seconds and chunk must be at least 1, got {self.seconds} and {self.chunk}")

    def settings(self) -> dict[str, Any]:
        """Return what the result of a unit depends on; the simulated time of all units is no part of it."""
        facts = asdict(self)
        del facts["seconds"]
        return facts

    def units(self) -> Sequence[str]:
        """Return the numbers of the units."""
        return [f"{k:05d}" for k in range(-(-self.seconds // (self.environments * self.chunk)))]

    def run(self, unit: str, folder: Path) -> UnitResult:  # noqa: ARG002 - the form of a soak test
        """Run the environments of a unit together, some of them alone, and share pipelines, each in a process."""
        compile_kernels(self)
        try:
            found = dict(map_indices(partial(_job, self, int(unit)), (_TOGETHER, _ALONE, _PIPELINES), workers=2))
        except WorkerError as error:
            return UnitResult(name=unit, problems=(str(error),))
        members, (together, grown), (frames, different) = self.members(int(unit)), found[_TOGETHER], found[_PIPELINES]
        problems = [f"{member}: {deeds.error}" for member, deeds in zip(members, together, strict=True) if deeds.error]
        for k, deeds in zip(self.chosen(int(unit)), found[_ALONE], strict=True):
            if difference := together[k].difference(deeds):
                problems.append(f"{members[k]}: {difference}")
        if grown > GROWTH:
            problems.append(f"{grown:.0f} MB more in the second half, {GROWTH:g} MB is the limit")
        return UnitResult(
            name=unit,
            counts={
                "simulated seconds": round(sum(deeds.seconds for deeds in together)),
                "decisions": sum(deeds.decisions for deeds in together),
                "environments": len(members),
                "of them compared with the same alone": len(found[_ALONE]),
                "frames on shared pipelines": frames,
            },
            largest={"growth in the second half of a unit [MB]": grown},
            problems=(*problems, *different),
        )

    def close(self) -> None:
        """Nothing is open between units."""

    def members(self, number: int) -> list[Member]:
        """Return the environments of a unit."""
        rng = np.random.default_rng([self.seed, number])
        seeds, fast = rng.integers(2**31, size=self.environments), rng.random(self.environments) < FAST
        return [
            Member(
                part=self.parts[(number + k) % len(self.parts)],
                seed=int(seeds[k]),
                perception="learned" if k < self.learned else "oracle",
                fast=bool(fast[k]),
                num_parts=self.num_parts,
                seconds=self.chunk,
            )
            for k in range(self.environments)
        ]

    def chosen(self, number: int) -> list[int]:
        """Return which environments of a unit are run again, alone."""
        return [(number * self.alone + k) % self.environments for k in range(min(self.alone, self.environments))]


@cache
def compile_kernels(soak: LoadSoak) -> None:
    """Make a decision with each environment of the first unit, so that no unit's memory grows by what compiling takes.

    It is done once in a process. Kernels that are compiled are kept on disk, where those of the units find them.
    """
    for member in soak.members(0):
        pick_alone(replace(member, seconds=1.0))


def _job(soak: LoadSoak, number: int, which: int) -> tuple[int, Any]:
    members = soak.members(number)
    if which == _TOGETHER:
        return which, pick_together(members, soak.threads)
    if which == _ALONE:
        return which, [pick_alone(members[k]) for k in soak.chosen(number)]
    first, second = (soak.parts[(number + k) % len(soak.parts)] for k in range(2))
    return which, differences((first, second), soak.num_parts, members[0].seed, soak.threads)
