"""Make a picture of a settled bin with the arm over it."""

import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from policies.portrait import portrait, save_png


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Make a picture of a settled bin with the arm over it. No GL driver is needed."""

    part: str = "tee"  # part_a, part_b, part_c, tee, bracket, or the path of an STL, OBJ or PLY file
    seed: int = 0  # of the pile
    width: int = 1200  # of the picture [px]
    height: int = 800  # [px]
    out: Path = Path("docs/cell.png")  # the PNG file


def main(args: Arguments) -> int:
    """Make the picture; return the exit code."""
    try:
        picture = portrait(args.part, args.seed, args.width, args.height)
    except (ValueError, OSError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    save_png(picture, args.out)
    print(f"picture   {args.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Arguments)))
