"""How fast clusters of different sizes would be, by simulations with what was measured."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from binpick_env.jobs.text_tables import columns
from perception.runtime.files import json_text, write_atomically
from perception.runtime.provenance import command_line, git_commit, machine, versions
from policies.benchmarks.clusters.schedule import Items, Machines, Schedule, Transport, simulate
from policies.benchmarks.clusters.transport import ITEM, MEGABYTE
from policies.benchmarks.measurement import Measurement, benchmark_table


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """How long the same items take on clusters of different sizes.

    Attributes:
        measured: What was measured of the cluster.
        items: What is computed.
        machines: Each cluster.
        schedules: How long it takes on each.
    """

    measured: tuple[Measurement, ...]
    items: Items
    machines: tuple[Machines, ...]
    schedules: tuple[Schedule, ...]

    def __str__(self) -> str:
        """Return what was measured and the table of predictions."""
        header = ("cores", "time [s]", "items/s", "speed-up", "efficiency", "taking results", "network", "limited by")
        cells: list[tuple[str, ...]] = [header]
        for machines, found in zip(self.machines, self.schedules, strict=True):
            shares = (f"{100 * share:.0f} %" for share in (found.efficiency, found.taking, found.network))
            rates = (f"{self.items.count / found.seconds:.3g}", f"{found.efficiency * machines.cores:.4g}")
            cells.append((str(machines.cores), f"{found.seconds:.0f}", *rates, *shares, found.limit))
        return f"{benchmark_table(self.measured)}\n\n{columns(cells)}"


def predict(measured: Sequence[Measurement], items: Items, clusters: Sequence[Machines], seed: int = 0) -> Prediction:
    """Simulate clusters of different sizes.

    Args:
        measured: Rows of :func:`~policies.benchmarks.clusters.transport.measure_transport`.
        items: What is computed.
        clusters: The clusters.
        seed: Seed of the times of the items.
    """
    medians = {row.name: row.median / 1000 for row in measured}
    transport = Transport(item=medians[ITEM], megabyte=medians[MEGABYTE])
    schedules = tuple(simulate(items, each, transport, seed) for each in clusters)
    return Prediction(measured=tuple(measured), items=items, machines=tuple(clusters), schedules=schedules)


def save_prediction(path: Path, prediction: Prediction) -> None:
    """Write a prediction as JSON, with machine, versions, commit and command."""
    facts = {"machine": machine(), "commit": git_commit(), "command": command_line(), "versions": versions()}
    write_atomically(path, json_text(facts | asdict(prediction)))
