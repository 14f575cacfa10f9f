"""Listeners follow a bin and change none of its numbers."""

import dataclasses
import os
import time
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest

from binpick_env.env import BinPickEnv
from policies.evaluation.bin_evaluation import BinError, evaluate_bin
from policies.evaluation.cell import Cell, CellCache
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.jobs import Job, run_job
from policies.evaluation.listeners import BinListener, Decision
from policies.evaluation.records import BinRecord
from policies.evaluation.watched_env import WatchedEnv
from policies.grasping.outcomes import Abstention, GraspOutcome
from tests.policies.fake_cell import FakeEnv, ScriptPicker, abstain, attempt, dice_cell

CONFIG = EvaluationConfig(num_parts=(6, 6))


class WatchedFakeEnv(FakeEnv, WatchedEnv):  # type: ignore[misc]
    """A cell without physics that reports its steps."""

    events: Any = ()

    def __init__(self, parts: int) -> None:
        FakeEnv.__init__(self, parts=parts)


def watched_cell(config: EvaluationConfig) -> Cell:
    env: Any = WatchedFakeEnv(parts=2)
    delivered = attempt(GraspOutcome.DELIVERED)
    return Cell(env, ScriptPicker(env, abstain(Abstention.IK_INFEASIBLE), delivered, delivered))


class Log(BinListener):
    """Logs its calls and returns names of pictures."""

    def __init__(self, name: str, notes: list[str] | None = None) -> None:
        self.name, self.notes = name, [] if notes is None else notes
        self.decisions: list[Decision] = []

    def bin_settled(self, env: BinPickEnv) -> str:
        self.notes.append(f"{self.name} settled on frame {env.frame_id}")
        return f"{self.name}_settled.jpg"

    def before_decision(self, env: BinPickEnv) -> None:
        self.notes.append(f"{self.name} before")

    def after_step(self, env: BinPickEnv) -> None:
        self.notes.append(f"{self.name} step")

    def after_decision(self, env: BinPickEnv, decision: Decision) -> str:
        self.notes.append(f"{self.name} after {decision.number}")
        self.decisions.append(decision)
        return "" if decision.number == 0 else f"{self.name}_{decision.number}.webp"

    def bin_ended(self, env: BinPickEnv) -> str:
        self.notes.append(f"{self.name} ended")
        return f"{self.name}_ended.jpg"

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.notes.append(f"{self.name} exited{'' if error is None else ' with ' + type(error).__name__}")


@dataclasses.dataclass(frozen=True)
class FileListeners:
    """Writes a file for each bin that it makes listeners for, with the id of the process."""

    needed: tuple[int, ...] = ()

    def listeners(self, index: int, folder: Path) -> list[BinListener]:
        (folder / f"listened_{index}").write_text(str(os.getpid()))
        return []

    def needs_bin(self, index: int) -> bool:
        return index in self.needed


def numbers(record: BinRecord) -> dict[str, Any]:
    """Return everything in a record except for wall clock and the pictures' names."""
    values = dataclasses.asdict(dataclasses.replace(record, wall=0.0, settle=0.0, render=0.0, before="", after=""))
    for pick in values["picks"]:
        pick["picture"] = ""
    return values


def test_listeners_are_called_in_order_and_the_record_holds_their_pictures_names() -> None:
    notes: list[str] = []
    logs = [BinListener(), Log("a", notes), Log("b", notes)]
    record = evaluate_bin(CONFIG, 0, logs, cells=CellCache(watched_cell))
    events = ["settled on frame 0", *[f"{event}{k}" for k in range(3) for event in ("before", "after ")], "ended"]
    events = [event if "before" not in event else "before" for event in events]
    assert notes == [f"{name} {event}" for event in events for name in "ab"] + ["b exited", "a exited"]
    assert (record.before, record.after) == ("a_settled.jpg", "a_ended.jpg")
    assert [pick.picture for pick in record.picks] == ["", "a_1.webp", "a_2.webp"]


def test_a_decision_has_the_frame_that_it_was_made_on() -> None:
    log = Log("a")
    record = evaluate_bin(CONFIG, 0, [log], cells=CellCache(watched_cell))
    assert [decision.frame_record for decision in log.decisions] == list(record.frames)
    assert [decision.result.frame_id for decision in log.decisions] == [0, 1, 2]


def test_listeners_change_no_number() -> None:
    alone = evaluate_bin(CONFIG, 0, cells=CellCache(watched_cell))
    assert numbers(evaluate_bin(CONFIG, 0, [Log("a")], cells=CellCache(watched_cell))) == numbers(alone)
    assert (alone.before, alone.after, {pick.picture for pick in alone.picks}) == ("", "", {""})


def test_the_time_of_listeners_is_left_out_of_the_wall_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])

    class Slow(Log):
        def bin_settled(self, env: BinPickEnv) -> str:
            now[0] += 1.0
            return ""

        def before_decision(self, env: BinPickEnv) -> None:
            now[0] += 10.0

        def after_decision(self, env: BinPickEnv, decision: Decision) -> str:
            now[0] += 100.0
            return ""

        def bin_ended(self, env: BinPickEnv) -> str:
            now[0] += 1000.0
            return ""

    record = evaluate_bin(CONFIG, 0, [Slow("a")], cells=CellCache(watched_cell))
    assert now[0] == 1331.0
    assert record.wall == 0.0


def test_listeners_exit_with_the_exception_of_a_bin_that_fails() -> None:
    def fail(result: object) -> None:
        raise FloatingPointError("the physics diverged")

    log = Log("a")
    with pytest.raises(BinError, match="the physics diverged"):
        evaluate_bin(CONFIG, 0, [log], fail, CellCache(watched_cell))
    assert log.notes[-1] == "a exited with FloatingPointError"
    assert "a ended" not in log.notes


def test_an_environment_that_reports_no_steps_is_refused() -> None:
    with pytest.raises(BinError, match="only a WatchedEnv reports its steps to listeners, got FakeEnv"):
        evaluate_bin(CONFIG, 0, [Log("a")], cells=CellCache(dice_cell))


def test_each_bin_gets_its_listeners(tmp_path: Path) -> None:
    run_job(CONFIG, Job(out=tmp_path, bins=2, listeners=FileListeners()), make_cell=dice_cell)
    assert sorted(path.name for path in tmp_path.glob("listened_*")) == ["listened_0", "listened_1"]


def test_a_bin_that_listeners_need_is_computed_again(tmp_path: Path) -> None:
    run_job(CONFIG, Job(out=tmp_path, bins=3), make_cell=dice_cell)
    job = Job(out=tmp_path, bins=3, listeners=FileListeners(needed=(1,)))
    run_job(CONFIG, job, make_cell=dice_cell)
    assert [path.name for path in tmp_path.glob("listened_*")] == ["listened_1"]
