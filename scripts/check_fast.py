"""Do attempts come out the same in the fast training mode? The same attempts, made in full and fast, compared."""

import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro
from tqdm import tqdm

from binpick_env.config import SensorPreset
from perception.runtime.files import json_text, write_atomically
from perception.runtime.provenance import command_line, git_commit
from perception.runtime.threads import one_core
from policies.selection.env import GraspSelectionEnv
from policies.selection.fast_agreement import agreement_table, paired_attempts


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Compare attempts from the same states; grasps are drawn at random from those on offer."""

    part: str = "tee"  # catalogue name, or path to an STL, OBJ or PLY file
    attempts: int = 100  # pairs
    seed: int = 0  # of the first pile
    sensor: SensorPreset = "good"  # the depth camera's noise
    min_parts: int = 20  # smallest fill of a bin
    max_parts: int = 30  # largest fill
    json: Path | None = None  # where to write the pairs


def main(args: Arguments) -> int:
    """Compare; return the exit code."""
    try:
        with one_core():
            full, fast = _env(args, fast=False), _env(args, fast=True)
            pairs = list(tqdm(paired_attempts(full, fast, args.seed, args.attempts), total=args.attempts, unit="pair"))
    except (ValueError, OSError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(agreement_table(pairs))
    if args.json is not None:
        facts = {"command": command_line(), "commit": git_commit(), "pairs": [asdict(pair) for pair in pairs]}
        write_atomically(args.json, json_text(facts))
    return 0


def _env(args: Arguments, *, fast: bool) -> GraspSelectionEnv:
    return GraspSelectionEnv(
        part=args.part,
        num_parts=(args.min_parts, args.max_parts),
        sensor=args.sensor,
        perception="oracle",
        threads=1,
        max_failures=None,
        fast=fast,
    )


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Arguments)))
