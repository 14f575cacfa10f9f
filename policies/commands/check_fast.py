"""``binpick check-fast``: the same attempts made in full and in the fast training mode, compared."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from policies.commands.cell_arguments import CellArguments
from policies.commands.command_line import exit_code, parse

if TYPE_CHECKING:
    from policies.selection.env import GraspSelectionEnv


@dataclass(frozen=True, kw_only=True)
class Arguments(CellArguments):
    """Compare attempts in full with attempts in the fast mode, from the same states, with random grasps."""

    attempts: int = 100  # number of pairs of attempts
    seed: int = 0  # seed of the first pile
    min_parts: int = 20  # smallest number of parts in a bin
    max_parts: int = 30  # largest number of parts in a bin
    json: Path | None = None  # JSON file for the pairs


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and compare; return the exit code."""
    return run(parse(Arguments, "check-fast", arguments))


def run(args: Arguments) -> int:
    """Compare; return the exit code."""
    return exit_code(lambda: _compare(args), (ValueError, OSError, RuntimeError))


def _compare(args: Arguments) -> str:
    from tqdm import tqdm

    from perception.runtime.files import json_text, write_atomically
    from perception.runtime.provenance import command_line, git_commit
    from perception.runtime.threads import one_core
    from policies.selection.fast_agreement import agreement_table, paired_attempts

    with one_core():
        full, fast = _env(args, fast=False), _env(args, fast=True)
        pairs = list(tqdm(paired_attempts(full, fast, args.seed, args.attempts), total=args.attempts, unit="pair"))
    if args.json is not None:
        facts = {"command": command_line(), "commit": git_commit(), "pairs": [asdict(pair) for pair in pairs]}
        write_atomically(args.json, json_text(facts))
    return agreement_table(pairs)


def _env(args: Arguments, *, fast: bool) -> "GraspSelectionEnv":
    from policies.selection.env import GraspSelectionEnv

    options = args.options()
    return GraspSelectionEnv(
        part=options.part,
        unit=options.unit,
        symmetry=options.symmetry,
        density=options.density,
        symmetry_tolerance=options.symmetry_tolerance,
        num_parts=(args.min_parts, args.max_parts),
        sensor=options.sensor,
        config=options.cell(),
        perception="oracle",
        threads=1,
        max_failures=None,
        fast=fast,
    )
