"""Units of work of a soak test: each is done once, and its result is one file."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

from perception.runtime.records import RecordFormat
from policies.soak.choices import SoakKind

FORMAT = RecordFormat(kind="soak record", version=1, remedy="delete it, and soak makes it again")


@dataclass(frozen=True, kw_only=True)
class UnitResult:
    """What one unit of work found.

    Attributes:
        name: Name of the unit within its kind.
        counts: Numbers of what was done, such as steps; those of several units are added up.
        largest: Measured values of which the largest of all units matters, such as a depth in millimetres.
        problems: One sentence for each rule that was broken.
        seconds: Wall clock time [s].
    """

    name: str
    counts: Mapping[str, int] = field(default_factory=dict)
    largest: Mapping[str, float] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    seconds: float = 0.0

    def save(self, path: Path) -> None:
        """Write the result, atomically."""
        FORMAT.save_plain(path, asdict(self))

    @classmethod
    def load(cls, path: Path) -> "UnitResult":
        """Read a result.

        Raises:
            RecordError: The file is missing, damaged, or of another kind or version.
        """
        return FORMAT.load_plain(path, lambda values: cls(**values | {"problems": tuple(values["problems"])}))


class Soak(Protocol):
    """One kind of soak test: its units, and how each is done."""

    @property
    def kind(self) -> SoakKind:
        """Name of the kind."""
        ...

    def settings(self) -> dict[str, Any]:
        """Return what the result of a unit depends on, apart from its name, as JSON types."""
        ...

    def units(self) -> Sequence[str]:
        """Return the names of all units; those of a longer run begin with those of a shorter one."""
        ...

    def run(self, unit: str, folder: Path) -> UnitResult:
        """Do a unit of work.

        Args:
            unit: Name of the unit.
            folder: Folder for what units of this kind share, such as the results of an undisturbed job.
        """
        ...

    def close(self) -> None:
        """End what was started for the units, such as processes."""
        ...
