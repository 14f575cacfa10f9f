"""``binpick soak``: long runs that look for crashes, leaks and half-written files."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from policies.commands.command_line import exit_code, parse
from policies.soak.choices import SoakKind

if TYPE_CHECKING:
    from policies.soak.unit import Soak, UnitResult


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Look for crashes, leaks and half-written files: random actions, malformed inputs, killed jobs.

    Every unit of work is saved as soon as it is finished: the same command resumes where it was stopped, and a larger
    --count adds to what is there. Exit codes: 0 if every rule was kept, 1 if one was broken.
    """

    # env: steps of BinPick-v0; select: decisions of BinPickSelect-v0; fuzz: malformed inputs; kill: killed jobs, full
    # disks, two writers; load: 16 environments in one process; all five in turn unless given
    kind: SoakKind | None = None
    # number of steps, decisions, inputs, kills or simulated seconds, rounded up to whole units of work; 100 000,
    # 10 000, 1000, 100 and 86 400 unless given
    count: int | None = None
    resets: int = 1000  # number of resets over which the growth of memory is fitted; 0 leaves it out
    skip: int = 0  # number of units at the beginning that are left out, because another machine does them
    seed: int = 0  # seed of everything that is drawn
    out: Path | None = None  # folder of the results; runs/soak-SEED unless given
    json: Path | None = None  # JSON file for the results; soak.json in the folder unless given

    def folder(self) -> Path:
        """Return where the results are kept."""
        return self.out or Path("runs") / f"soak-{self.seed}"

    def soaks(self) -> "list[Soak]":
        """Return the kinds that are run."""
        from policies.soak import EnvSoak, FuzzSoak, KillSoak, LoadSoak, SelectSoak
        from policies.soak.cell.memory import MemorySettings

        memory = MemorySettings(resets=self.resets) if self.resets else None
        kinds: dict[SoakKind, Callable[[], Soak]] = {
            "env": lambda: EnvSoak(seed=self.seed, memory=memory, steps=self._count(EnvSoak.steps)),
            "select": lambda: SelectSoak(seed=self.seed, decisions=self._count(SelectSoak.decisions)),
            "fuzz": lambda: FuzzSoak(seed=self.seed, inputs=self._count(FuzzSoak.inputs)),
            "kill": lambda: KillSoak(seed=self.seed, kills=self._count(KillSoak.kills)),
            "load": lambda: LoadSoak(seed=self.seed, seconds=self._count(LoadSoak.seconds)),
        }
        return [make() for kind, make in kinds.items() if self.kind in (None, kind)]

    def _count(self, default: int) -> int:
        return default if self.count is None else self.count


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and run the soak tests; return the exit code."""
    return run(parse(Arguments, "soak", arguments))


def run(args: Arguments) -> int:
    """Run the soak tests; return the exit code: 1 if a rule was broken."""
    stopped = f"stopped; finished units are kept in {args.folder()}: the same command resumes there"
    results: dict[str, list[UnitResult]] = {}
    code = exit_code(lambda: _soak(args, results), (ValueError, OSError, RuntimeError), stopped)
    broken = any(result.problems for found in results.values() for result in found)
    return 1 if code == 0 and broken else code


def _soak(args: Arguments, results: "dict[str, list[UnitResult]]") -> str:
    from tqdm import tqdm

    from perception.runtime.files import json_text, write_atomically
    from perception.runtime.provenance import command_line, git_commit, machine
    from perception.runtime.threads import one_core
    from policies.soak.run import run_soak, soak_table

    if args.seed < 0:
        raise ValueError(f"--seed must be 0 or more, got {args.seed}")
    soaks, tables = args.soaks(), []
    for soak in soaks:
        units = len(soak.units())
        if not 0 <= args.skip < units:
            wanted = f"0 or more and less than the {units} units of {soak.kind}"
            raise ValueError(f"--skip must be {wanted}, got {args.skip}")
    for soak in soaks:
        results[soak.kind] = found = []
        with one_core(), tqdm(total=len(soak.units()) - args.skip, desc=soak.kind, unit="unit", smoothing=0) as bar:
            for result in run_soak(soak, args.folder(), skip=args.skip):
                found.append(result)
                bar.set_postfix(problems=sum(len(each.problems) for each in found))
                bar.update()
        tables.append(soak_table(soak.kind, found))
    facts = {"command": command_line(), "commit": git_commit(), "machine": machine(), "seed": args.seed}
    kinds = {kind: [asdict(result) for result in found] for kind, found in results.items()}
    path = args.json or args.folder() / "soak.json"
    write_atomically(path, json_text({**facts, "kinds": kinds}))
    return "\n".join([*tables, f"numbers   {path}"])
