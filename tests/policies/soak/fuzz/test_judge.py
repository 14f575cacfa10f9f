"""What counts as a result, as an error of our own, and as a failure."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from perception.geometry import require_rigid
from policies.soak.fuzz import commands
from policies.soak.fuzz.commands import RefusedError, TracebackError, call_command
from policies.soak.fuzz.judge import Outcome, judge


def foreign() -> None:
    """A ValueError that explains nothing to a user, since numpy raises it."""
    np.zeros(3) + np.zeros(4)


def short() -> None:
    from policies.evaluation.jobs import Job

    Job(out=Path("runs"), bins=0)


CASES: tuple[tuple[Callable[[], object], Outcome, str], ...] = (
    (lambda: 3, "result", ""),
    (lambda: require_rigid("T_world_cam", np.zeros((4, 4))), "refused", "T_world_cam must"),
    (short, "refused", "bins and workers must be at least 1"),
    (lambda: Path("missing.json").open(), "refused", "No such file or directory: 'missing.json'"),  # noqa: SIM115
    (foreign, "failure", "ValueError at"),
    (lambda: {}["K"], "failure", "KeyError at"),
    (lambda: require_rigid("T", None), "failure", "perception/geometry.py:"),  # type: ignore[arg-type]
)


@pytest.mark.parametrize(("case", "outcome", "text"), CASES)
def test_a_case_is_judged_by_its_end(case: Callable[[], object], outcome: Outcome, text: str, tmp_path: Path) -> None:
    verdict = judge(case, tmp_path)
    assert verdict.outcome == outcome
    assert text in verdict.text


def test_drafts_and_halves_of_files_are_failures(tmp_path: Path) -> None:
    (tmp_path / ".there.before").touch()

    def write(name: str, text: str) -> Callable[[], object]:
        return lambda: (tmp_path / name).write_text(text)

    assert judge(write("numbers.json", json.dumps({"a": 1})), tmp_path).outcome == "result"
    assert judge(write(".numbers.json.77", ""), tmp_path).text == "the draft .numbers.json.77 was left behind"
    assert judge(write("half.json", '{"a": '), tmp_path).text == "half.json is not whole"
    assert judge(write("half.npz", "PK"), tmp_path).text == "half.npz is not whole"


def test_a_command_ends_with_a_message_or_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from policies.commands import main

    monkeypatch.setattr(main, "show_status", lambda: None)
    assert call_command(["--version"], tmp_path).startswith("binpick")
    with pytest.raises(RefusedError, match="did you mean pick"):
        call_command(["pik"], tmp_path)
    monkeypatch.setattr(main, "main", lambda _: 3)
    with pytest.raises(TracebackError, match="binpick pick ended with code 3"):
        call_command(["pick"], tmp_path)
    assert main.__name__ == commands.ENTRY
