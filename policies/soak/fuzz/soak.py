"""The soak test of malformed inputs."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from policies.soak.choices import SoakKind
from policies.soak.fuzz.child import serve
from policies.soak.fuzz.grammars import GRAMMARS
from policies.soak.fuzz.keeper import LIMIT, ChildKeeper
from policies.soak.unit import UnitResult


@dataclass(frozen=True, kw_only=True)
class FuzzSoak:
    """Malformed inputs in units of a few, the grammars in turn.

    Attributes:
        inputs: Number of inputs, rounded up to whole units.
        seed: Seed; input i of a grammar is drawn from (seed, i, number of the grammar).
        chunk: Number of inputs of a unit.
        grammars: Names of the grammars, taken in turn.
    """

    kind: ClassVar[SoakKind] = "fuzz"
    inputs: int = 1000
    seed: int = 0
    chunk: int = 20
    grammars: tuple[str, ...] = tuple(GRAMMARS)
    _keepers: dict[Path, ChildKeeper] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.inputs < 1 or self.chunk < 1:
            raise ValueError(f"inputs and chunk must be at least 1, got {self.inputs} and {self.chunk}")
        unknown = [name for name in self.grammars if name not in GRAMMARS]
        if unknown or not self.grammars:
            raise ValueError(f"grammars must be some of {', '.join(GRAMMARS)}, got {self.grammars}")

    def settings(self) -> dict[str, Any]:
        """Return what the result of a unit depends on; the number of inputs is no part of it."""
        return {"seed": self.seed, "chunk": self.chunk, "grammars": self.grammars, "limit": LIMIT}

    def units(self) -> Sequence[str]:
        """Return the names of the units, which are their numbers."""
        return [f"{k:05d}" for k in range(-(-self.inputs // self.chunk))]

    def run(self, unit: str, folder: Path) -> UnitResult:
        """Give the inputs of a unit to the product."""
        keeper = self._keepers.setdefault(folder, ChildKeeper(serve, folder))
        counts = dict.fromkeys(("inputs", "results", "refused"), 0)
        problems = []
        for i in range(int(unit) * self.chunk, (int(unit) + 1) * self.chunk):
            name = self.grammars[i % len(self.grammars)]
            verdict = keeper.run(name, (self.seed, i, list(GRAMMARS).index(name)))
            counts["inputs"] += 1
            counts["results"] += verdict.outcome == "result"
            counts["refused"] += verdict.outcome == "refused"
            if verdict.outcome == "failure":
                problems.append(f"{name}, input {i}: {verdict.text}")
        return UnitResult(name=unit, counts=counts, problems=tuple(problems))

    def close(self) -> None:
        """End the child process."""
        for keeper in self._keepers.values():
            keeper.close()
        self._keepers.clear()
