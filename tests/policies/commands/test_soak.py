"""`binpick soak`: kinds and counts of the command line, exit codes, the file of numbers."""

import json
from pathlib import Path

import pytest

from policies.commands import soak
from policies.commands.command_line import parse
from policies.soak import EnvSoak, FuzzSoak
from policies.soak.unit import UnitResult


def arguments(*options: str) -> soak.Arguments:
    args = parse(soak.Arguments, "soak", options)
    assert isinstance(args, soak.Arguments)
    return args


def test_all_kinds_run_in_full_unless_options_say_otherwise() -> None:
    assert {each.kind: len(each.units()) for each in arguments().soaks()} == {
        "env": 201,
        "select": 500,
        "fuzz": 50,
        "kill": 125,
        "load": 45,
    }
    assert arguments().folder() == Path("runs/soak-0")
    (env,) = arguments("--kind", "env", "--count", "1000", "--resets", "0", "--seed", "3").soaks()
    assert env == EnvSoak(steps=1000, seed=3)
    (select,) = arguments("--kind", "select", "--count", "30").soaks()
    assert len(select.units()) == 2
    (kill,) = arguments("--kind", "kill", "--count", "6").soaks()
    assert len(kill.units()) == 7


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a unit of malformed inputs take no time; the second one finds a problem."""

    def run(self: FuzzSoak, unit: str, folder: Path) -> UnitResult:
        return UnitResult(name=unit, counts={"inputs": 20}, problems=("it broke",) if unit == "00001" else ())

    monkeypatch.setattr(FuzzSoak, "run", run)


def call(out: Path, count: int) -> int:
    return soak.main(["--kind", "fuzz", "--count", str(count), "--out", str(out)])


@pytest.mark.usefixtures("quick")
def test_a_broken_rule_is_exit_code_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(tmp_path, 20) == 0
    assert "inputs    20" in capsys.readouterr().out
    assert call(tmp_path, 40) == 1
    shown = capsys.readouterr().out
    assert "  00001: it broke" in shown
    assert f"numbers   {tmp_path}/soak.json" in shown
    facts = json.loads((tmp_path / "soak.json").read_text())
    assert [unit["name"] for unit in facts["kinds"]["fuzz"]] == ["00000", "00001"]
    assert {"command", "commit", "machine", "seed"} <= set(facts)


def test_nonsense_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(tmp_path, 0) == 2
    assert capsys.readouterr().err.endswith("error: inputs and chunk must be at least 1, got 0 and 20\n")
    assert soak.main(["--kind", "fuzz", "--seed", "-1", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.endswith("error: --seed must be 0 or more, got -1\n")
    assert soak.main(["--kind", "fuzz", "--count", "40", "--skip", "2", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.endswith("--skip must be 0 or more and less than the 2 units of fuzz, got 2\n")


@pytest.mark.usefixtures("quick")
def test_the_first_units_are_left_to_another_machine(tmp_path: Path) -> None:
    assert soak.main(["--kind", "fuzz", "--count", "60", "--skip", "2", "--out", str(tmp_path)]) == 0
    facts = json.loads((tmp_path / "soak.json").read_text())
    assert [unit["name"] for unit in facts["kinds"]["fuzz"]] == ["00002"]
