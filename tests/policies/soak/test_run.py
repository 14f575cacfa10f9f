"""The loop over units of work: each is done once, and what is there is read."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from policies.soak.choices import SoakKind
from policies.soak.run import SHOWN, run_soak, soak_table
from policies.soak.unit import UnitResult


@dataclass
class Counting:
    """A soak test that counts the units that it does."""

    kind: SoakKind = "env"
    seed: int = 0
    count: int = 2
    done: list[str] = field(default_factory=list)
    closed: int = 0

    def settings(self) -> dict[str, Any]:
        return {"seed": self.seed}

    def units(self) -> Sequence[str]:
        return [f"{k:05d}" for k in range(self.count)]

    def run(self, unit: str, folder: Path) -> UnitResult:
        self.done.append(unit)
        problems = ("it broke",) if unit == "00001" else ()
        return UnitResult(name=unit, counts={"steps": 3}, largest={"depth": 1.0 + int(unit)}, problems=problems)

    def close(self) -> None:
        self.closed += 1


def test_a_finished_unit_is_not_done_again(tmp_path: Path) -> None:
    first = list(run_soak(Counting(), tmp_path))
    more = Counting(count=3)
    again = list(run_soak(more, tmp_path))
    assert more.done == ["00002"]
    assert more.closed == 1
    assert again[:2] == first
    assert first[1].problems == ("it broke",)


def test_units_that_another_machine_does_are_left_out(tmp_path: Path) -> None:
    rest = Counting(count=4)
    assert [result.name for result in run_soak(rest, tmp_path, skip=2)] == ["00002", "00003"]
    both = Counting(count=4)
    assert [result.name for result in run_soak(both, tmp_path)] == ["00000", "00001", "00002", "00003"]
    assert both.done == ["00000", "00001"]


def test_a_damaged_record_is_made_again(tmp_path: Path) -> None:
    list(run_soak(Counting(), tmp_path))
    (tmp_path / "env" / "00000.json").write_text("{")
    again = Counting()
    list(run_soak(again, tmp_path))
    assert again.done == ["00000"]


def test_results_of_another_seed_are_not_mixed(tmp_path: Path) -> None:
    list(run_soak(Counting(), tmp_path))
    with pytest.raises(ValueError, match=r"holds results of soak of another configuration .*seed: 0 there, 1 here"):
        list(run_soak(Counting(seed=1), tmp_path))


def test_a_crash_of_a_unit_closes_the_soak(tmp_path: Path) -> None:
    class Crashing(Counting):
        def run(self, unit: str, folder: Path) -> UnitResult:
            raise KeyboardInterrupt

    crashing = Crashing()
    with pytest.raises(KeyboardInterrupt):
        list(run_soak(crashing, tmp_path))
    assert crashing.closed == 1


def test_the_table_adds_counts_and_takes_the_largest(tmp_path: Path) -> None:
    text = soak_table("env", list(run_soak(Counting(), tmp_path)))
    rows = {line.rsplit(maxsplit=1)[0].strip(): line.split()[-1] for line in text.splitlines()[1:]}
    assert (rows["steps"], rows["depth"], rows["problems"]) == ("6", "2", "1")
    assert "  00001: it broke" in text
    many = [UnitResult(name="a", problems=("x",) * (SHOWN + 2))]
    assert soak_table("env", many).endswith("and 2 more problems, in the records")


def test_a_record_is_plain_json(tmp_path: Path) -> None:
    list(run_soak(Counting(), tmp_path))
    assert json.loads((tmp_path / "env" / "00001.json").read_text())["problems"] == ["it broke"]
