"""The judgement of one case: a result, an error of our own, or a failure."""

import json
import traceback
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from policies.soak.fuzz.grammar import Case

Outcome = Literal["result", "refused", "failure"]
_ROOT = f"{Path(__file__).resolve().parents[3]}/"
_PACKAGES = tuple(_ROOT + name for name in ("perception", "binpick_env", "policies"))
_SHORTEST = 20  # length of the shortest message that can say what was required [characters]
_LONGEST = 300  # length of a problem's text [characters]


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """How a case ended.

    Attributes:
        outcome: A result, an error of our own, or a failure.
        text: Message of the error, or what failed.
    """

    outcome: Outcome
    text: str = ""


def judge(case: Case, folder: Path) -> Verdict:
    """Make the call of a case and judge its end and the files that it leaves in its folder."""
    before = {path for path in folder.rglob("*") if path.is_file()}
    try:
        case()
        verdict = Verdict(outcome="result")
    except Exception as error:
        verdict = _verdict(error)
    left = "; ".join(_half_written({path for path in folder.rglob("*") if path.is_file()} - before))
    return Verdict(outcome="failure", text=left) if left and verdict.outcome != "failure" else verdict


def _verdict(error: Exception) -> Verdict:
    """Tell an error of our own, which is raised in our files and explains itself, from any other one."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = frames[-1].filename.startswith(_PACKAGES)
    names_file = isinstance(error, OSError) and error.filename is not None
    text = " ".join(str(error).split())
    if isinstance(error, ValueError | OSError) and (ours or names_file) and len(text) >= _SHORTEST:
        return Verdict(outcome="refused", text=text[:_LONGEST])
    place = next((frame for frame in reversed(frames) if frame.filename.startswith(_PACKAGES)), frames[-1])
    where = f"{place.filename.removeprefix(_ROOT)}:{place.lineno}"
    return Verdict(outcome="failure", text=f"{type(error).__name__} at {where}: {text[:_LONGEST]}")


def _half_written(paths: set[Path]) -> Iterator[str]:
    """Yield what is wrong with files that a case wrote: drafts, and files that cannot be read."""
    for path in sorted(paths):
        if path.name.startswith("."):
            yield f"the draft {path.name} was left behind"
        elif not {".json": _is_json, ".npz": zipfile.is_zipfile}.get(path.suffix, Path.is_file)(path):
            yield f"{path.name} is not whole"


def _is_json(path: Path) -> bool:
    try:
        json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return False
    return True
